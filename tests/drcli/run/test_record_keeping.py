"""Every training leaves a record: at its start, while it runs, at its end, and after a crash."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest

from drcli.base.errors import StorageError
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.training_records import read_files, read_trainings
from drcli.model.training_state import write_outcome
from drcli.records.iteration import encode_history
from drcli.records.training_record import RunOutcome, StartSpending
from drcli.run.outcome import INTERRUPTED, Outcome
from drcli.run.record_keeping import RecordKeeping
from drcli.transfer.record_training import settle
from evaluations import evaluated
from unwatched import ending, running


def records(racer, prefix=""):
    found, damaged = read_trainings(racer.bucket, prefix)
    assert damaged == []
    return sorted(found, key=lambda record: record.began_at)


def learned(racer, make_record, iterations=3, prefix="model-1"):
    """Give a model checkpoints and a learning curve."""
    store = racer.store(prefix)
    for number in range(iterations + 1):
        store.save(number, 100 * number, b"weights %d" % number, optimizer=b"moments")
    store.record_evaluation(evaluated("1_Step-100.ckpt", 80.0), "progress")
    history = [make_record(n, evaluation_lap_s=[15.0 - n]) for n in range(iterations)]
    racer.bucket.put(keys.history(prefix), encode_history(history))


class Ended:
    """What a start came to, in the bucket."""

    def __init__(self, racer):
        self._racer = racer

    def __call__(self, plan, **changes):
        outcome = replace(plan.job.begun, ended_at=plan.job.begun.started_at + 60.0, **changes)
        write_outcome(ModelStore(self._racer.bucket, plan.job.config.model.prefix), outcome)


def test_a_start_leaves_a_record_with_everything_that_it_was_made_of(racer):
    racer.hyperparameters(lr=0.0005)
    racer.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=team/model-1",
        "DR_WORLD_NAME=Vegas_track",
        "DR_MODEL_DESCRIPTION=Wide kerbs",
        "DR_WEBHOOK_URL=https://hooks.example/secret-path",
    )

    plan = racer.start(seed=7)

    [record] = records(racer)
    [start] = record.starts
    assert (record.prefix, record.id) == ("team/model-1", plan.job.training)
    assert (record.state, record.world, record.race_type) == (
        "running",
        "Vegas_track",
        "TIME_TRIAL",
    )
    assert (record.algorithm, record.action_space) == ("clipped_ppo", "discrete, 3")
    assert record.hyperparameters["lr"] == 0.0005
    assert record.description == "Wide kerbs"
    assert (start.seed, start.resumes) == (7, None)
    assert start.settings is not None
    assert start.settings["DR_WORLD_NAME"] == "Vegas_track"
    assert start.versions["drcli"]
    assert start.machine["processor"]
    texts = read_files(ModelStore(racer.bucket, record.prefix), record.id)
    assert texts[start.files["reward_function.py"]] == "def reward_function(p): ..."
    assert b"secret-path" not in b"".join(racer.bucket.get(i.key) for i in racer.bucket.list(""))


def test_the_files_of_other_workers_are_recorded(racer):
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_TRAIN_MULTI_CONFIG=True")
    (racer.folder / "system.env").write_text("DR_WORKERS=2\n")
    (racer.folder / "worker-2.env").write_text("DR_WORLD_NAME=Vegas_track\n")

    racer.start()

    [record] = records(racer)
    assert record.workers == 2
    assert record.newest.worker_settings == [{"DR_WORLD_NAME": "Vegas_track"}]


def test_a_resume_goes_on_with_the_record_and_says_how_the_start_before_ended(racer, make_record):
    first = racer.start()
    learned(racer, make_record)
    Ended(racer)(first, state="stopped", code=143, message="Stopped by SIGTERM.")
    (racer.folder / "custom_files" / "reward_function.py").write_text("def reward_function(q): ...")

    second = racer.start(resume=True)

    [record] = records(racer)
    one, other = record.starts
    assert record.id == first.job.training == second.job.training
    assert record.number_of_starts == 2
    assert (one.state, one.message) == ("stopped", "Stopped by SIGTERM.")
    assert one.ended_at == pytest.approx(first.job.begun.started_at + 60.0)
    assert (other.state, other.resumes) == ("running", "3_Step-300.ckpt")
    texts = read_files(ModelStore(racer.bucket, record.prefix), record.id)
    rewards = [texts[start.files["reward_function.py"]] for start in record.starts]
    assert rewards == ["def reward_function(p): ...", "def reward_function(q): ..."]


def test_a_start_whose_machine_vanished_is_lost_in_the_record(racer, make_record):
    racer.start()
    learned(racer, make_record)

    racer.start(resume=True)

    [record] = records(racer)
    assert [start.state for start in record.starts] == ["lost", "running"]


def test_a_wipe_completes_the_record_of_the_training_before_and_begins_another(racer, make_record):
    first = racer.start()
    learned(racer, make_record)
    racer.bucket.put(
        keys.spending("model-1", 1, first.job.session),
        StartSpending(first.job.session, "vm", 2.5, 0.75).encode(),
    )
    racer.bucket.put(
        "model-1/metrics/evaluation/evaluation-20260101000000.json",
        json.dumps(
            {"metrics": [{"episode_status": "Lap complete", "elapsed_time_in_milliseconds": 9500}]}
        ).encode(),
    )

    second = racer.start(wipe=True)

    old, new = records(racer)
    assert (old.id, new.id) == (first.job.training, second.job.training)
    assert old.id != new.id
    assert old.state == "lost"
    assert (old.gone_at is not None, new.gone_at) == (True, None)
    assert (old.hours, old.usd) == (2.5, 0.75)
    assert (old.results.iterations, old.results.best_lap_s) == (3, 13.0)
    assert (old.results.best_checkpoint, old.results.best_score) == ("1_Step-100.ckpt", 80.0)
    assert (old.results.trials, old.results.best_trial_lap_s) == (1, 9.5)
    assert new.results.iterations == 0


def forget_records(racer, *names):
    """Make a model look as if an old version had trained it."""
    key = keys.training_start("model-1")
    start = json.loads(racer.bucket.get(key))
    for name in ("training", *names):
        start.pop(name, None)
        for each in start["earlier"]:
            each.pop(name, None)
    racer.bucket.put(key, json.dumps(start).encode())
    racer.bucket.delete([info.key for info in racer.bucket.list("training-records/")])


def test_a_model_of_an_old_version_gets_its_record_when_it_is_resumed(racer, make_record):
    first = racer.start(seed=11)
    learned(racer, make_record)
    forget_records(racer)
    Ended(racer)(first, state="finished", code=0, message="Training is complete.")

    plan = racer.start(resume=True)
    again = racer.start(resume=True)

    [record] = records(racer)
    assert record.id == plan.job.training == again.job.training
    assert [start.state for start in record.starts] == ["finished", "lost", "running"]
    assert [start.seed for start in record.starts] == [11, 11, 11]
    assert record.starts[0].files
    assert record.results.iterations == 3


def test_a_model_whose_start_recorded_the_seed_only_is_resumed(racer, make_record):
    racer.start()
    learned(racer, make_record)
    racer.bucket.put(keys.training_start("model-1"), b'{"seed": 5}')
    racer.bucket.delete([info.key for info in racer.bucket.list("training-records/")])

    racer.start(resume=True)

    [record] = records(racer)
    assert record.starts[0].settings is None
    assert record.newest.settings is not None


def test_a_damaged_record_costs_its_past_and_not_the_start(racer, make_record):
    plan = racer.start()
    learned(racer, make_record)
    racer.bucket.put(keys.training_record("model-1", plan.job.training), b"{half")

    racer.start(resume=True)

    [record] = records(racer)
    assert record.id == plan.job.training
    assert [start.state for start in record.starts] == ["lost", "running"]


def test_where_records_may_not_be_written_the_training_starts_and_says_so(racer, told, monkeypatch):
    put = racer.bucket.put

    def refuse(key, data, **options):
        if key.startswith("training-records/"):
            raise StorageError("May not write.", remedy="Allow s3:PutObject.")
        put(key, data, **options)

    monkeypatch.setattr(racer.bucket, "put", refuse)

    plan = racer.start()

    assert plan.job.training == ""
    assert told == [
        "The record of this training could not be written: May not write. Allow s3:PutObject."
    ]


def test_a_clone_names_the_training_of_its_parent(trained):
    parent = records(trained)[0].id
    trained.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=model-2",
        "DR_LOCAL_S3_PRETRAINED=True",
        "DR_LOCAL_S3_PRETRAINED_PREFIX=model-1",
    )

    trained.start()

    [record] = records(trained, "model-2")
    assert record.parent is not None
    assert (record.parent.prefix, record.parent.name) == ("model-1", "5_Step-500.ckpt")
    assert record.parent_training == parent


def test_models_that_were_never_trained_here_leave_no_record(racer):
    settle(ModelStore(racer.bucket, "imported", "imported/metrics"), gone=True)

    assert records(racer) == []


class Meter:
    """What a training has cost."""

    def __init__(self, usd_per_hour=None):
        self.own_hours, self.own_usd = 1.5, 0.3 if usd_per_hour else 0.0
        self.spending = SimpleNamespace(usd_per_hour=usd_per_hour)


@pytest.fixture
def keeping(racer):
    """The duty of a training that has just started; its thread works at once."""

    def begin(plan, usd_per_hour=None):
        duty = RecordKeeping(running(plan.job, racer.bucket), Meter(usd_per_hour))
        if duty.every_s is not None:
            duty.thread = SimpleNamespace(finish=lambda errand, *_: errand())
        return duty

    return begin


def test_the_record_has_results_and_cost_while_the_training_runs(racer, keeping, make_record):
    duty = keeping(racer.start(), usd_per_hour=0.2)
    learned(racer, make_record)

    duty.work()

    [record] = records(racer)
    assert (record.state, record.results.iterations) == ("running", 3)
    assert (record.hours, record.usd) == (1.5, 0.3)


def test_evaluations_that_the_record_has_are_not_read_again(racer, keeping, make_record):
    duty = keeping(racer.start())
    learned(racer, make_record)
    trial = {"episode_status": "Lap complete", "elapsed_time_in_milliseconds": 12_000}
    key = keys.evaluation_metrics("model-1/metrics", "20260101000000")
    racer.bucket.put(key, json.dumps({"metrics": [trial]}).encode())
    duty.work()
    racer.bucket.put(key, b"{}")

    duty.work()

    [record] = records(racer)
    results = record.results
    assert (results.evaluations, results.trials, results.best_trial_lap_s) == (1, 1, 12.0)


@pytest.mark.parametrize(
    ("outcome", "state"),
    [
        (Outcome(0, "Training is complete."), "finished"),
        (Outcome(143, "Stopped by SIGTERM."), "stopped"),
        (Outcome(6, "NaN detected."), "failed"),
        (Outcome(INTERRUPTED, "The machine goes away."), "interrupted"),
    ],
)
def test_the_record_says_how_the_training_ended(racer, keeping, make_record, outcome, state):
    duty = keeping(racer.start())
    learned(racer, make_record)

    duty.finish(ending(outcome.code, message=outcome.message))

    [record] = records(racer)
    assert (record.state, record.message) == (state, outcome.message)
    assert record.ended_at is not None
    assert (record.newest.state, record.results.iterations) == (state, 3)
    assert (record.hours, record.usd) == (1.5, None)


def test_hours_of_earlier_starts_count_too(racer, keeping, make_record):
    first = racer.start()
    learned(racer, make_record)
    racer.bucket.put(
        keys.spending("model-1", 1, first.job.session),
        StartSpending(first.job.session, "vm", 2.0).encode(),
    )

    keeping(racer.start(resume=True)).work()

    [record] = records(racer)
    assert record.hours == 3.5
    assert [start.hours for start in record.starts] == [2.0, 1.5]


def test_a_record_that_was_forgotten_meanwhile_does_not_come_back(racer, keeping):
    duty = keeping(racer.start())
    racer.bucket.delete([info.key for info in racer.bucket.list("training-records/")])

    duty.work()
    duty.finish(ending())

    assert records(racer) == []


def test_a_training_without_a_record_needs_no_duty(racer, keeping):
    plan = racer.start()

    duty = keeping(replace(plan, job=replace(plan.job, training="")))
    duty.finish(ending())

    assert records(racer)[0].state == "running"


def test_an_outcome_of_another_start_is_not_taken_for_its_own(racer, make_record):
    racer.start()
    learned(racer, make_record)
    write_outcome(
        ModelStore(racer.bucket, "model-1"),
        RunOutcome("another", "vm", 1.0, 2.0, state="finished", code=0),
    )

    racer.start(resume=True)

    [record] = records(racer)
    assert record.starts[0].state == "lost"
