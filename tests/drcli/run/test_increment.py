"""The edit of run.env that makes the next training go on from this model."""

import os
import stat
import time

import psutil
import pytest

from drcli.base.errors import SettingsError
from drcli.model import lease
from drcli.model.model_store import ModelStore
from drcli.records.run_record import RunRecord, run_folder
from drcli.run.increment import make_increment, plan_increment


@pytest.fixture
def increment(trained):
    """Makes an increment of model-1 in one go."""

    def run(**options):
        settings = trained.settings()
        planned = plan_increment(settings, **options)
        make_increment(planned, settings.storage)
        return planned.step

    return run


def test_the_next_training_starts_from_this_models_weights(trained, increment):
    step = increment()
    trained.start()

    found = trained.store("model-2").load_latest()
    assert (step.before, step.after) == ("model-1", "model-2")
    assert step.pretrained.name == "5_Step-500.ckpt"
    assert found is not None
    assert found.tensors == b"weights 5"
    assert trained.note("model-2")["pretrained"]["prefix"] == "model-1"


def test_everything_else_in_the_file_stays_as_it_is(trained, increment):
    (trained.folder / "run.env").write_bytes(
        b"# Mine.\r\n"
        b"DR_WORLD_NAME=reinvent_base\r\n"
        b"export DR_LOCAL_S3_MODEL_PREFIX=model-1 # the fast one\r\n"
        b"DR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/metrics\r\n"
        b"\r\n"
        b'DR_LOCAL_S3_PRETRAINED="False"\r\n'
        b"DR_LOCAL_S3_PRETRAINED_CHECKPOINT=best\r\n"
        b"# DR_LOCAL_S3_PRETRAINED_PREFIX=old"
    )

    increment()

    assert (trained.folder / "run.env").read_bytes() == (
        b"# Mine.\r\n"
        b"DR_WORLD_NAME=reinvent_base\r\n"
        b"export DR_LOCAL_S3_MODEL_PREFIX=model-2 # the fast one\r\n"
        b"DR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/metrics\r\n"
        b"\r\n"
        b'DR_LOCAL_S3_PRETRAINED="True"\r\n'
        b"DR_LOCAL_S3_PRETRAINED_CHECKPOINT=best\r\n"
        b"# DR_LOCAL_S3_PRETRAINED_PREFIX=old\r\n"
        b"DR_LOCAL_S3_PRETRAINED_PREFIX=model-1\r\n"
    )


def test_references_in_the_prefix_stay_and_the_pretrained_one_is_written_out(trained, increment):
    trained.run_env("DR_CAR_NAME=model", "DR_LOCAL_S3_MODEL_PREFIX=$DR_CAR_NAME-1")

    step = increment()

    lines = (trained.folder / "run.env").read_text().splitlines()
    assert step.after == trained.settings().model_prefix == "model-2"
    assert lines[1] == "DR_LOCAL_S3_MODEL_PREFIX=$DR_CAR_NAME-2"
    assert "DR_LOCAL_S3_PRETRAINED_PREFIX=model-1" in lines


def test_a_prefix_from_system_env_gets_a_line_in_run_env(trained, increment):
    (trained.folder / "system.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model-1\n")
    trained.run_env("DR_WORLD_NAME=reinvent_base")

    increment()

    assert trained.settings().model_prefix == "model-2"
    assert (trained.folder / "system.env").read_text() == "DR_LOCAL_S3_MODEL_PREFIX=model-1\n"


def test_the_file_of_an_experiment_is_the_one_that_counts(trained, increment):
    experiment = trained.folder / "experiments" / "first"
    experiment.mkdir(parents=True)
    (experiment / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model-1\n")
    (trained.folder / "system.env").write_text("DR_EXPERIMENT_NAME=first\n")
    untouched = (trained.folder / "run.env").read_bytes()

    step = increment()

    assert step.file == str(experiment / "run.env")
    assert trained.settings().model_prefix == "model-2"
    assert (experiment / "run.env.bak").read_text() == "DR_LOCAL_S3_MODEL_PREFIX=model-1\n"
    assert (trained.folder / "run.env").read_bytes() == untouched


def test_a_copy_of_the_file_stays_and_nothing_else(trained, increment):
    path = trained.folder / "run.env"
    path.chmod(0o640)
    before = path.read_bytes()

    step = increment()

    left = sorted(p.name for p in trained.folder.iterdir() if "run.env" in p.name)
    assert left == ["run.env", "run.env.bak"]
    assert (trained.folder / "run.env.bak").read_bytes() == before
    assert step.backup == str(trained.folder / "run.env.bak")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_link_keeps_pointing_to_the_file(trained, increment):
    path = trained.folder / "run.env"
    real = path.rename(trained.folder / "shared.env")
    path.symlink_to(real)

    increment()

    assert path.is_symlink()
    assert "DR_LOCAL_S3_MODEL_PREFIX=model-2\n" in real.read_text()


def test_a_name_of_ones_own_is_taken_as_it_is(trained, increment):
    increment(prefix="team/fast")

    assert trained.settings().model_prefix == "team/fast"


@pytest.mark.parametrize("name", ["fast car", "$DR_WORLD_NAME-1", "../fast", "/", ""])
def test_a_name_that_cannot_stand_in_the_bucket_is_refused(trained, increment, name):
    before = (trained.folder / "run.env").read_bytes()

    with pytest.raises(SettingsError, match="DR_LOCAL_S3_MODEL_PREFIX="):
        increment(prefix=name)

    assert (trained.folder / "run.env").read_bytes() == before


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("model-1", "model-1 is the model that it would continue"),
        ("model-1/next", "wiping one would delete the other"),
    ],
)
def test_the_name_of_the_old_model_or_one_inside_it_is_refused(increment, name, words):
    with pytest.raises(SettingsError, match=words):
        increment(prefix=name)


def test_a_name_that_is_in_use_is_refused_unless_it_may_be_wiped(trained, increment):
    trained.bucket.put("model-2/model/x", b"theirs")
    trained.bucket.put("model-20/model/x", b"a neighbour's")

    with pytest.raises(SettingsError, match="s3://bucket/model-2 already contains a model"):
        increment()
    step = increment(wiping=True)

    assert step.wipes
    assert trained.bucket.list("model-2/") == []
    assert trained.bucket.exists("model-20/model/x")


def test_a_model_that_is_being_trained_elsewhere_is_not_wiped(trained, increment):
    lease.take(ModelStore(trained.bucket, "model-2"), "theirs")
    trained.bucket.put("model-2/model/x", b"theirs")

    with pytest.raises(SettingsError, match="model-2 is being trained by process"):
        increment(wiping=True)

    assert trained.bucket.exists("model-2/model/x")


def test_a_model_without_a_checkpoint_cannot_be_gone_on_from(racer):
    with pytest.raises(SettingsError) as caught:
        plan_increment(racer.settings())

    assert str(caught.value) == (
        "run.env line 1: DR_LOCAL_S3_MODEL_PREFIX=model-1: there is no checkpoint at "
        "s3://bucket/model-1/model/."
    )


def test_while_the_model_trains_it_is_not_gone_on_from(trained, increment):
    started = psutil.Process().create_time()
    record = RunRecord(
        0, "s", "bucket", "model-1", "oval", "running", os.getpid(), started, time.time()
    )
    record.write(run_folder(trained.folder, trained.settings().run_id))

    with pytest.raises(SettingsError, match="Run 0 is training s3://bucket/model-1 already"):
        increment()


@pytest.mark.parametrize(
    ("name", "value"),
    [("DR_LOCAL_S3_MODEL_PREFIX", "model-1"), ("DR_LOCAL_S3_PRETRAINED", "False")],
)
def test_a_value_in_the_environment_would_undo_the_edit(increment, monkeypatch, name, value):
    monkeypatch.setenv(name, value)

    with pytest.raises(SettingsError, match=f"environment: {name} is set there"):
        increment()


def test_metrics_that_would_go_into_the_old_model_are_refused(trained, increment):
    trained.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_LOCAL_S3_METRICS_PREFIX=model-1/metrics"
    )

    with pytest.raises(SettingsError) as caught:
        increment()

    assert str(caught.value).startswith("run.env line 2: DR_LOCAL_S3_METRICS_PREFIX=model-1/metric")
    assert "$DR_LOCAL_S3_MODEL_PREFIX/metrics" in caught.value.remedy


def test_a_file_that_was_changed_meanwhile_is_left_alone(trained):
    settings = trained.settings()
    planned = plan_increment(settings)
    trained.run_env("DR_LOCAL_S3_MODEL_PREFIX=other")

    with pytest.raises(SettingsError, match="changed while this command was waiting"):
        make_increment(planned, settings.storage)

    assert trained.settings().model_prefix == "other"


def overrides(**options):
    from drcli.run.increment import Overrides

    return Overrides(**options)


def test_the_next_model_gets_another_track_values_and_description(trained, increment):
    """003-11: a clone with a changed track, reward, batch and stop."""
    (trained.folder / "new.py").write_text("def reward_function(params):\n    return 2.0\n")

    step = increment(
        overrides=overrides(
            checkpoint="best",
            world="paddle",
            reward=trained.folder / "new.py",
            hyperparameters=("batch_size=128", "loss_type=huber"),
            settings=("DR_TRAIN_MAX_ITERATIONS=7",),
            description="Wider kerbs, $5 faster",
        )
    )
    trained.start()

    settings = trained.settings()
    custom = trained.folder / "custom_files"
    assert step.pretrained.name == "3_Step-300.ckpt"
    assert (settings.world_name, settings.train_max_iterations) == ("paddle", 7)
    assert (custom / "reward_function.py").read_text().endswith("return 2.0\n")
    assert "p): ..." in (custom / "reward_function.py.bak").read_text()
    assert b'"batch_size": 128' in (custom / "hyperparameters.json").read_bytes()
    assert trained.store("model-2").load_latest().tensors == b"weights 3"
    note = trained.bucket.get("model-2/notes/000-description.json")
    assert b"Wider kerbs, $5 faster" in note


def test_the_description_of_the_old_model_does_not_describe_the_new_one(trained, increment):
    increment(overrides=overrides(description="The first"))

    trained.start()
    trained.store("model-2").save(1, 100, b"weights")
    increment()

    assert trained.settings().model_description == ""


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"world": "no_such_track"}, "no_such_track"),
        ({"hyperparameters": ("lr",)}, "--hyperparameter lr: it is not KEY=VALUE"),
        ({"hyperparameters": ("lr=fast",)}, "lr"),
        ({"hyperparameters": ("lrr=0.1",)}, "lrr"),
        ({"hyperparameters": ("stack_size=4",)}, "stack_size"),
        ({"hyperparameters": ("lr=0.1e-3", "lr=0.2e-3")}, "given twice"),
        ({"settings": ("DR_TRAIN_MAX_ITERATONS=3",)}, "there is no such setting"),
        ({"settings": ("DR_TRAIN_MAX_ITERATIONS=-3",)}, "is below 0"),
        ({"settings": ("DR_LOCAL_S3_PRETRAINED=False",)}, "changes it by itself"),
        ({"checkpoint": 99}, "the newest is 5"),
        ({"checkpoint": "first-lap"}, "no evaluation during its training has completed a lap"),
    ],
)
def test_a_wrong_override_changes_nothing(trained, increment, wrong, said):
    before = {path: path.read_bytes() for path in trained.folder.rglob("*") if path.is_file()}

    with pytest.raises(SettingsError) as caught:
        increment(overrides=overrides(**wrong))

    assert said in str(caught.value)
    after = {path: path.read_bytes() for path in trained.folder.rglob("*") if path.is_file()}
    assert after == before


@pytest.mark.parametrize("text", ["def reward_function(", "x = 1\n", ""])
def test_a_reward_function_that_cannot_be_used_changes_nothing(trained, increment, text):
    (trained.folder / "new.py").write_text(text)

    with pytest.raises(SettingsError):
        increment(overrides=overrides(reward=trained.folder / "new.py"))

    kept = (trained.folder / "custom_files" / "reward_function.py").read_text()
    assert kept == "def reward_function(p): ..."
