"""The parameter files that the reference's tools expect in the bucket."""

import pytest
import yaml

from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.model.files.params_yaml import (
    evaluation_parameters,
    moved_training_parameters,
    training_parameters,
)


@pytest.fixture
def settings(tmp_path):
    def load(*lines: str) -> Settings:
        (tmp_path / "run.env").write_text("\n".join(lines))
        (tmp_path / "system.env").write_text("")
        return load_settings(tmp_path, environ={})

    return load


def test_obstacles_are_listed_in_object_avoidance_only(settings):
    avoiding = settings("DR_RACE_TYPE=OBJECT_AVOIDANCE", 'DR_OA_OBJECT_POSITIONS="0.5,-1"')

    told = yaml.safe_load(training_parameters(avoiding))
    untold = yaml.safe_load(training_parameters(settings()))

    assert told["NUMBER_OF_OBSTACLES"] == 6
    assert told["OBJECT_POSITIONS"] == ["0.5,-1"]
    assert "BOT_CAR_SPEED" not in told
    assert "NUMBER_OF_OBSTACLES" not in untold


def test_bots_are_listed_in_head_to_bot(settings):
    told = yaml.safe_load(training_parameters(settings("DR_RACE_TYPE=HEAD_TO_BOT")))

    assert (told["NUMBER_OF_BOT_CARS"], told["BOT_CAR_SPEED"]) == (3, 0.2)
    assert told["PENALTY_SECONDS"] == 5.0


def test_a_race_against_a_model_lists_both_racers(settings):
    s = settings(
        "DR_RACE_TYPE=HEAD_TO_MODEL",
        "DR_LOCAL_S3_MODEL_PREFIX=mine",
        "DR_EVAL_OPP_S3_MODEL_PREFIX=yours",
    )

    told = yaml.safe_load(evaluation_parameters(s, "mine/e", "mine/m.json", "yours/m.json"))

    assert told["MODEL_S3_PREFIX"] == ["mine", "yours"]
    assert told["METRICS_S3_OBJECT_KEY"] == ["mine/m.json", "yours/m.json"]
    assert told["CAR_COLOR"] == ["Purple", "Orange"]
    assert {len(told[name]) for name in ("MODEL_S3_BUCKET", "DISPLAY_NAME", "RACER_NAME")} == {2}


def test_a_copy_of_a_model_names_its_own_place_and_keeps_everything_else(settings):
    written = training_parameters(settings("DR_WORLD_NAME=Oval_track", "DR_CAR_COLOR=Blue"))

    moved = yaml.safe_load(moved_training_parameters(written, "uploads", "team/m-1"))

    same = moved.items() & yaml.safe_load(written).items()
    assert {("WORLD_NAME", "Oval_track"), ("CAR_COLOR", "Blue")} <= same
    assert dict(moved.items() - same) == {
        "METRICS_S3_BUCKET": "uploads",
        "METRICS_S3_OBJECT_KEY": "team/m-1/metrics/TrainingMetrics.json",
        "MODEL_METADATA_FILE_S3_KEY": "team/m-1/model/model_metadata.json",
        "REWARD_FILE_S3_KEY": "team/m-1/reward_function.py",
        "SAGEMAKER_SHARED_S3_BUCKET": "uploads",
        "SAGEMAKER_SHARED_S3_PREFIX": "team/m-1",
        "SIMTRACE_S3_BUCKET": "uploads",
        "SIMTRACE_S3_PREFIX": "team/m-1",
    }


@pytest.mark.parametrize("data", [b"", b"[1, 2]", b"{", b"\xff"])
def test_a_file_that_is_not_a_parameter_file_is_refused(data):
    with pytest.raises(ValueError, match=r"^it "):
        moved_training_parameters(data, "uploads", "m")
