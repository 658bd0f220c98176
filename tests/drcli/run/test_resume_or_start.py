"""What one command does with a prefix, whatever it finds there."""

import re
import time
from dataclasses import replace

import pytest

from drcli.base.errors import SettingsError, StorageError, TrainedElsewhere
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.checks import before_start
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome, write_outcome
from drcli.records.run_record import Lease
from drcli.records.training_record import RunOutcome
from drcli.run import resume_or_start
from drcli.run.plan import EndWorkPlan, RunPlan, StartOptions
from drcli.run.resume_or_start import NothingToDo, prepare_next

MODEL = "model-1"


@pytest.fixture
def again(racer):
    """Gives the command once more, and lets what it starts end without a word."""

    def give(*, wait=False, **options):
        found = prepare_next(racer.settings(), StartOptions(**options), wait=wait)
        if not isinstance(found, NothingToDo):
            lease.release(ModelStore(racer.bucket, MODEL), found.job.session)
        return found

    return give


@pytest.fixture
def ended(racer):
    """Records how the newest start ended."""

    def end(state, code, **changes):
        begun = read_outcome(ModelStore(racer.bucket, MODEL))
        assert begun is not None
        outcome = replace(begun, state=state, code=code, message="It ended.", **changes)
        write_outcome(ModelStore(racer.bucket, MODEL), outcome)

    return end


def learn(racer):
    racer.store(MODEL).save(1, 100, b"weights", optimizer=b"moments")


def test_an_empty_prefix_starts(again, racer):
    planned = again()

    assert isinstance(planned, RunPlan)
    assert planned.resumes is None
    assert planned.job.whole_run
    outcome = read_outcome(ModelStore(racer.bucket, MODEL))
    assert (outcome.state, outcome.session) == ("running", planned.job.session)


def test_a_run_whose_machine_vanished_goes_on(again, racer):
    first = again()
    learn(racer)

    second = again()

    assert isinstance(second, RunPlan)
    assert second.resumes == "1_Step-100.ckpt"
    assert second.job.seed == first.job.seed
    texts = [entry.text for entry in second.job.noted]
    assert any("ended without recording why" in text for text in texts)


def test_the_same_command_line_again_and_again_changes_nothing_but_the_session(again, racer):
    again()
    learn(racer)

    for _ in range(3):
        planned = again()
        assert isinstance(planned, RunPlan)
        assert planned.resumes == "1_Step-100.ckpt"

    assert len(racer.note(MODEL)["earlier"]) == 3


def test_a_finished_run_does_nothing(again, racer, ended):
    again()
    learn(racer)
    ended("finished", 0)
    before = {info.key: info.etag for info in racer.bucket.list("")}

    found = again()

    assert isinstance(found, NothingToDo)
    assert "It ended." in found.sentence
    assert {info.key: info.etag for info in racer.bucket.list("")} == before


@pytest.mark.parametrize("asked", [{"until_laps": 3}, {"until_lap_time_s": 8.0}, {}])
def test_a_run_that_version_0_1_0_has_finished_does_nothing(again, racer, ended, asked):
    options = {"goals": asked}
    racer.run_env(
        f"DR_LOCAL_S3_MODEL_PREFIX={MODEL}",
        "DR_TRAIN_STOP_LAP_TIME=9.5",
        "DR_TRAIN_STOP_PROGRESS=99",
    )
    again(**options)
    learn(racer)
    goals = read_outcome(ModelStore(racer.bucket, MODEL)).goals
    confirmed = r",? and (then 38 of 40|on 40) laps from other starts( are as good)?"
    ended("finished", 0, goals=re.sub(confirmed, "", goals))

    assert isinstance(again(**options), NothingToDo)
    racer.run_env(f"DR_LOCAL_S3_MODEL_PREFIX={MODEL}", "DR_TRAIN_STOP_LAP_TIME=9")
    assert isinstance(again(**options), RunPlan)


@pytest.mark.parametrize(
    "raise_goal",
    [
        lambda racer: racer.hyperparameters(term_cond_max_episodes=77),
        lambda racer: racer.run_env(f"DR_LOCAL_S3_MODEL_PREFIX={MODEL}", "DR_TRAIN_MAX_MINUTES=9"),
    ],
)
def test_raising_a_goal_continues_a_finished_run(again, racer, ended, raise_goal):
    again()
    learn(racer)
    ended("finished", 0)
    raise_goal(racer)

    found = again()

    assert isinstance(found, RunPlan)
    assert found.resumes == "1_Step-100.ckpt"


def test_work_left_at_the_end_is_all_that_is_done(again, racer, ended):
    again()
    learn(racer)
    ended("finished", 0, left=("upload", "import"))
    before = racer.note(MODEL)

    found = again()

    assert isinstance(found, EndWorkPlan)
    assert found.job.end_work == ("upload", "import")
    assert found.job.begun.message == "It ended."
    assert racer.note(MODEL) == before
    assert read_outcome(ModelStore(racer.bucket, MODEL)).state == "finished"


@pytest.mark.parametrize(("state", "code"), [("stopped", 143), ("interrupted", 75)])
def test_what_was_ended_on_purpose_stays_ended_until_somebody_resumes_it(
    again, racer, ended, state, code
):
    again()
    learn(racer)
    ended(state, code, stays_ended=True)

    assert isinstance(again(), NothingToDo)
    assert "stays stopped" in again().sentence
    racer.start(resume=True)
    assert isinstance(again(), RunPlan)


@pytest.mark.parametrize(("state", "code"), [("interrupted", 75), ("failed", 4), ("stopped", 143)])
def test_what_was_not_ended_on_purpose_goes_on(again, racer, ended, state, code):
    again()
    learn(racer)
    ended(state, code)

    assert isinstance(again(), RunPlan)


def cut_off(racer, monkeypatch, after):
    """Start, and let the machine vanish after so many writes."""
    writes = 0
    put = racer.bucket.put

    def vanish(key, data, *, watch=None):
        nonlocal writes
        writes += 1
        if writes > after:
            raise KeyboardInterrupt
        put(key, data, watch=watch)

    with monkeypatch.context() as patch:
        patch.setattr(racer.bucket, "put", vanish)
        with pytest.raises(KeyboardInterrupt):
            prepare_next(racer.settings(), StartOptions(), wait=False)
    held = lease.read_lease(ModelStore(racer.bucket, MODEL))
    if held is not None:
        lease.write_lease(ModelStore(racer.bucket, MODEL), replace(held, released=True))


@pytest.mark.parametrize("after", range(1, 9))
def test_a_first_start_that_was_cut_off_anywhere_starts_over(again, racer, monkeypatch, after):
    cut_off(racer, monkeypatch, after)

    found = again()

    assert isinstance(found, RunPlan)
    assert found.resumes is None
    assert keys.training_start(MODEL) in {info.key for info in racer.bucket.list("")}


def test_a_first_start_with_the_weights_of_another_model_starts_over_with_them(
    trained,
):
    racer = trained
    racer.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=model-2",
        "DR_LOCAL_S3_PRETRAINED=True",
        "DR_LOCAL_S3_PRETRAINED_PREFIX=model-1",
    )
    racer.bucket.put("model-2/ip/run.json", b'{"seed": 1}')
    racer.bucket.put("model-2/model/0_Step-0.ckpt.safetensors", b"half")

    found = prepare_next(racer.settings(), StartOptions(), wait=False)

    assert isinstance(found, RunPlan)
    assert found.pretrained is not None
    begins = racer.store("model-2").load_latest()
    assert begins is not None
    assert begins.tensors == racer.store("model-1").load_latest().tensors


def test_files_of_somebody_else_are_in_the_way(again, racer):
    racer.bucket.put(f"{MODEL}/holiday.jpg", b"a picture")
    racer.bucket.put(keys.training_start(MODEL), b'{"seed": 1}')

    with pytest.raises(SettingsError, match="It holds files, but no checkpoint"):
        again()

    assert [info.key for info in racer.bucket.list("")] == [
        f"{MODEL}/holiday.jpg",
        keys.training_start(MODEL),
    ]


def test_an_owner_that_lives_here_is_waited_for_or_left_alone(again, racer):
    first = prepare_next(racer.settings(), StartOptions(), wait=False)

    with pytest.raises(TrainedElsewhere, match="is being trained by process") as left:
        again()

    assert left.value.code == 9
    held = lease.live_holder(ModelStore(racer.bucket, MODEL))
    assert held is not None
    assert held.session == first.job.session


def test_another_start_that_was_faster_is_left_alone(again, racer, monkeypatch):
    examine = before_start.examine

    def slow(*args):
        examined = examine(*args)
        theirs = Lease("theirs", "elsewhere", 1, time.time(), term=1)
        lease.write_lease(ModelStore(racer.bucket, MODEL), theirs)
        return examined

    class Renewed(Exception):
        pass

    def looks(self):
        if lease.live_holder(self.model) is not None:
            raise Renewed  # the wait has its own tests

    monkeypatch.setattr(before_start, "examine", slow)
    monkeypatch.setattr(resume_or_start.OwnerWait, "until_free", looks)

    with pytest.raises(Renewed):
        again()

    assert lease.read_lease(ModelStore(racer.bucket, MODEL)).session == "theirs"


@pytest.mark.parametrize("also", ["wipe", "resume"])
def test_other_ways_to_start_cannot_be_combined_with_it(again, also):
    with pytest.raises(SettingsError, match="cannot be combined"):
        again(**{also: True})


def test_a_damaged_record_of_the_outcome_does_not_keep_a_run_from_going_on(again, racer, told):
    again()
    learn(racer)
    racer.bucket.put(keys.outcome(MODEL), b'{"state": "fini')

    assert isinstance(again(), RunPlan)
    assert "outcome.json is damaged" in told[0]


def test_time_to_live_counts_from_the_first_start(again, racer, ended):
    racer.run_env(f"DR_LOCAL_S3_MODEL_PREFIX={MODEL}", "DR_TIME_TO_LIVE_MINUTES=60")
    again()
    learn(racer)
    ended("interrupted", 75, began_at=1_000_000.0)

    found = again()

    assert isinstance(found, RunPlan)
    assert found.job.ends_at == 1_000_000.0 + 3600.0
    assert "1970-01-12 14:46 UTC (DR_TIME_TO_LIVE_MINUTES)" in found.ends
    assert read_outcome(ModelStore(racer.bucket, MODEL)).began_at == 1_000_000.0


def test_the_record_is_read_back_as_it_was_written():
    outcome = RunOutcome("s", "host", 1.0, 2.0, "finished", "Ends.", 0, "m", "r", 3.0, True, ("a",))

    assert RunOutcome.decode(outcome.encode()) == outcome


@pytest.mark.parametrize(("waits", "code", "waited_s"), [(True, 75, 900.0), (False, 4, 5.0)])
def test_a_start_waits_for_a_bucket_that_does_not_answer_yet_and_can_be_tried_again(
    racer, monkeypatch, waits, code, waited_s
):
    now_s = [0.0]
    silent = Endpoint("http://127.0.0.1:1", "key", "secret")

    def pause(seconds):
        now_s[0] += seconds

    def opened(_config, **options):
        return S3Bucket(silent, "bucket", **options, clock=lambda: now_s[0], pause=pause)

    monkeypatch.setattr(resume_or_start, "open_bucket", opened)

    with pytest.raises(StorageError, match="no server answers there") as failure:
        prepare_next(racer.settings(), StartOptions(), wait=waits)

    assert failure.value.code == code
    assert now_s[0] == pytest.approx(waited_s)
