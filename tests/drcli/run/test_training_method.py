"""`--teacher` and the key of a model: which training method counts, and where it is kept."""

import json

import pytest

from drcli.base.errors import SettingsError
from drcli.model import keys
from drcli.model.files.hyperparameters import Hyperparameters, with_method
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.train.trainer import _learners


def method_of(plan) -> str:
    text = plan.job.inputs[keys.HYPERPARAMETERS_FILE]
    return Hyperparameters.from_bytes(text.encode()).training_method


def begun(racer, **options):
    """A start that has published its first checkpoint."""
    plan = racer.start(**options)
    files = {
        name: plan.job.inputs[name]
        for name in (keys.HYPERPARAMETERS_FILE, keys.MODEL_METADATA_FILE)
    }
    prefix = plan.job.config.model.prefix
    racer.store(prefix).save(0, 0, b"weights", counters=Counters(inputs=files))
    return plan


def test_the_option_counts_for_the_model_and_leaves_the_files_of_the_racer_alone(racer):
    plan = begun(racer, method="teacher")

    own = json.loads(racer.bucket.get(keys.hyperparameters("model-1")))
    assert method_of(plan) == own["training_method"] == "teacher"
    assert racer.bucket.get("custom_files/hyperparameters.json") == b"{}"
    assert (racer.folder / "custom_files/hyperparameters.json").read_text() == "{}"


def test_a_resumed_training_keeps_its_teacher_until_somebody_says_otherwise(racer):
    begun(racer, method="teacher")

    kept = racer.start(resume=True)
    racer.hyperparameters(training_method="camera")
    by_file = racer.start(resume=True)
    racer.hyperparameters()
    by_option = racer.start(resume=True, method="camera")

    assert [method_of(plan) for plan in (kept, by_file, by_option)] == [
        "teacher",
        "camera",
        "camera",
    ]
    [told] = [each for each in kept.warnings if "training_method" in each]
    assert told.endswith(
        "has no training_method, so that of model-1 is kept: teacher. --no-teacher, or "
        '"training_method": "camera" in the file, goes on without it.'
    )
    assert not any("training_method" in each for each in by_option.warnings)


def test_a_model_with_the_weights_of_one_that_has_a_teacher_keeps_it(racer):
    from drcli.model.files.hyperparameters import is_taught

    begun(racer, method="teacher")

    assert is_taught(ModelStore(racer.bucket, "model-1"))
    assert not is_taught(ModelStore(racer.bucket, "another"))


def test_a_teacher_does_not_go_with_sac(racer):
    racer.model_metadata(
        training_algorithm="sac",
        action_space_type="continuous",
        action_space={
            "steering_angle": {"low": -30.0, "high": 30.0},
            "speed": {"low": 1.0, "high": 3.0},
        },
    )
    racer.hyperparameters(exploration_type="additive_noise")

    with pytest.raises(SettingsError) as refused:
        racer.start(method="teacher")

    text = f"{refused.value} {refused.value.remedy}"
    assert "hyperparameters.json" in text
    assert "training_method=teacher" in text
    assert "training_algorithm=sac" in text
    assert "--no-teacher" in text


def test_several_learner_processes_are_one_with_a_teacher_and_the_start_says_so(racer):
    (racer.folder / "system.env").write_text("DR_TRAIN_LEARNERS=2\n")

    taught, alone = racer.start(method="teacher"), racer.start(wipe=True)

    assert any("DR_TRAIN_LEARNERS=2" in each and "one process" in each for each in taught.warnings)
    assert [_learners(plan.job) for plan in (taught, alone)] == [1, 2]


def test_a_stage_may_not_have_another_method(racer):
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_CURRICULUM_FILE=stages.yaml")
    (racer.folder / "stages.yaml").write_text(
        "stages:\n"
        "- name: one\n  goal: {iterations: 2}\n"
        "- name: two\n  hyperparameters: {training_method: camera}\n"
    )

    with pytest.raises(SettingsError, match="training_method=camera in stage 2"):
        racer.start(method="teacher")


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ('{\n  "lr": 1\n}', '{"training_method": "teacher", \n  "lr": 1\n}'),
        ("{}", '{"training_method": "teacher" }'),
        ('{"training_method" :"camera"}', '{"training_method": "teacher"}'),
        ('{"training_method": 3, "lr": 1}', '{"training_method": "teacher", "lr": 1}'),
        ("not JSON", "not JSON"),
    ],
)
def test_all_other_lines_of_the_file_stay_where_they_are(text, changed):
    assert with_method(text.encode(), "teacher").decode() == changed


@pytest.mark.parametrize(("lr", "warned"), [(0.001, True), (0.00003, False)])
def test_going_on_without_a_teacher_needs_small_steps(racer, lr, warned):
    begun(racer, method="teacher")
    racer.hyperparameters(lr=lr)

    told = racer.start(resume=True, method="camera").warnings

    assert any(f"lr={lr:g} is high" in each and "lr=3e-05" in each for each in told) == warned
