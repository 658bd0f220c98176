"""A start below a prefix whose model was trained, but has no checkpoint any more."""

import re
import shlex
from functools import partial

import pytest

from drcli.base.errors import ProblemsError
from drcli.checks.start_rules import review_prefix
from drcli.config.loading import load_settings
from drcli.model import keys
from drcli.model.checkpoints import CheckpointsLost, checkpoint_objects
from drcli.model.history import write_history
from drcli.model.model_prefix import ModelListing
from drcli.model.model_store import ModelStore
from drcli.model.repair import refuse_lost
from drcli.records.iteration import IterationRecord
from drcli.run.plan import StartOptions, prepare
from drcli.run.resume_or_start import prepare_next

MODEL = "model-1"


def record(iteration: int) -> IterationRecord:
    return IterationRecord(
        iteration=iteration,
        checkpoint=f"{iteration}_Step-{100 * iteration}.ckpt",
        episodes=1,
        steps=100,
        total_steps=100 * (iteration + 1),
        mean_reward=1.0,
        mean_progress=50.0,
        full_laps=0,
        best_lap_s=None,
        drive_s=1.0,
        elapsed_s=float(iteration),
    )


@pytest.fixture
def trained(racer):
    """A model with five checkpoints, a history, and two traces."""
    for number in range(5):
        racer.store(MODEL).save(number, 100 * number, b"weights", optimizer=b"moments")
    write_history(ModelStore(racer.bucket, MODEL), [record(n) for n in range(4)])
    for iteration in (0, 3):
        racer.bucket.put(keys.training_trace(MODEL, iteration), b"episode,steps\n")
    return racer


def empty_checkpoints(bucket):
    for key in checkpoint_objects(ModelStore(bucket, MODEL)):
        bucket.put(key, b"")


def empty_all(bucket):
    """As a power cut left it before buckets were flushed."""
    for info in bucket.list(keys.folder(MODEL)):
        if info.key != keys.training_trace(MODEL, 0):
            bucket.put(info.key, b"")


def delete_checkpoints(bucket):
    bucket.delete(checkpoint_objects(ModelStore(bucket, MODEL)))


def leave_the_pointer(bucket):
    bucket.delete(i.key for i in bucket.list("") if i.key != keys.coach_checkpoint(MODEL))


LOSSES = [empty_checkpoints, empty_all, delete_checkpoints, leave_the_pointer]


@pytest.mark.parametrize("lose", LOSSES)
@pytest.mark.parametrize("how", ["--resume", "--resume-or-start", ""])
def test_no_start_begins_again_among_what_is_left_of_a_model(trained, lose, how):
    lose(trained.bucket)
    before = {i.key: trained.bucket.get(i.key) for i in trained.bucket.list("")}
    plan = partial(prepare_next, wait=False) if how == "--resume-or-start" else prepare

    with pytest.raises(CheckpointsLost, match="has no checkpoint that can be read") as refused:
        plan(trained.settings(), StartOptions(resume=how == "--resume"))

    assert refused.value.code == 4
    assert "-w" not in refused.value.remedy
    assert {i.key: trained.bucket.get(i.key) for i in trained.bucket.list("")} == before


def test_the_refusal_says_what_is_lost_and_what_is_left(trained):
    empty_checkpoints(trained.bucket)

    with pytest.raises(CheckpointsLost) as refused:
        refuse_lost(ModelStore(trained.bucket, MODEL))

    said = str(refused.value)
    assert "trained for 4 iterations" in said
    assert "Lost: 4 checkpoints (1 to 4)" in said
    assert "the learning curve of 4 iterations (0 to 3), traces of 2 iterations" in said


@pytest.mark.parametrize("metrics", ["", "DR_LOCAL_S3_METRICS_PREFIX=model-1/metrics\n"])
def test_the_command_of_the_refusal_starts_over_beside_it(trained, metrics):
    delete_checkpoints(trained.bucket)
    trained.bucket.put("model-2/mine", b"")
    run_env = trained.folder / "run.env"
    run_env.write_text(f"DR_LOCAL_S3_MODEL_PREFIX={MODEL}\n{metrics}" + run_env.read_text())

    with pytest.raises(CheckpointsLost) as refused:
        prepare(trained.settings(), StartOptions(resume=True))

    [command] = re.findall("`(.*)`", refused.value.remedy)
    change, start = command.split(" && ")
    values = dict(word.split("=") for word in shlex.split(change)[2:])
    assert start == "dr-start-training"
    assert values["DR_LOCAL_S3_MODEL_PREFIX"] == "model-3"
    there = load_settings(trained.folder, environ=values)
    assert there.metrics_prefix == "model-3/metrics"
    assert review_prefix(ModelListing(ModelStore(trained.bucket, "model-3"))) == []


def test_a_prefix_of_the_environment_is_changed_there(trained, monkeypatch):
    delete_checkpoints(trained.bucket)
    monkeypatch.setenv("DR_LOCAL_S3_MODEL_PREFIX", MODEL)

    with pytest.raises(CheckpointsLost) as refused:
        prepare(trained.settings(), StartOptions(resume=True))

    assert "`DR_LOCAL_S3_MODEL_PREFIX=model-2 dr-start-training`" in refused.value.remedy


def test_the_rule_about_the_prefix_says_it_too(trained):
    empty_checkpoints(trained.bucket)

    [problem] = review_prefix(ModelListing(ModelStore(trained.bucket, MODEL)))

    assert "has no checkpoint that can be read" in problem.message
    assert "--resume" not in problem.remedy


def test_a_trainer_does_not_begin_again_either(trained):
    empty_checkpoints(trained.bucket)

    with pytest.raises(CheckpointsLost):
        refuse_lost(ModelStore(trained.bucket, MODEL))

    assert len(ModelListing(ModelStore(trained.bucket, MODEL)).traces) == 2


def test_one_readable_checkpoint_is_enough(trained):
    for key in checkpoint_objects(ModelStore(trained.bucket, MODEL)):
        if "1_Step" not in key:
            trained.bucket.put(key, b"")

    refuse_lost(ModelStore(trained.bucket, MODEL))


def test_nothing_is_lost_where_nothing_was_published(racer):
    racer.bucket.put(keys.checkpoint_tensors(MODEL, "0_Step-0.ckpt"), b"")

    refuse_lost(ModelStore(racer.bucket, MODEL))


def test_the_new_model_is_refused_nothing_else(trained):
    with pytest.raises(ProblemsError, match="It holds a model of drcli"):
        prepare(trained.settings(), StartOptions())
