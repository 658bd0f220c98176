"""Folders of all years load: every name that the reference's templates and scripts ever had."""

from pathlib import Path

import pytest

from drcli.config.settings import catalogue
from drcli.config.settings_report import check_settings, inspect_values
from drcli.config.unused_names import FORMER, old_names

ALL_NAMES = Path(__file__).resolve().parents[4] / "shared" / "spec" / "drfc-variable-names.txt"

RUN_2020 = {
    "DR_RUN_ID": "0",
    "DR_WORLD_NAME": "LGSWide",
    "DR_CHANGE_START_POSITION": "True",
    "DR_ALTERNATE_DRIVING_DIRECTION": "False",
    "DR_RACE_TYPE": "TIME_TRIAL",
    "DR_TARGET_REWARD_SCORE": "None",
    "DR_NUMBER_OF_EPISODES": "0",
    "DR_CAR_COLOR": "Red",
    "DR_CAR_NAME": "FastCar",
    "DR_UPLOAD_S3_PREFIX": "DeepRacer-SageMaker-RoboMaker-comm-1234",
    "DR_UPLOAD_MODEL_NAME": "mymodelname",
    "DR_EVAL_NUMBER_OF_TRIALS": "5",
    "DR_EVAL_NUMBER_OF_RESETS": "0",
    "DR_EVAL_IS_CONTINUOUS": "False",
    "DR_EVAL_OFF_TRACK_PENALTY": "5.0",
    "DR_COLLISION_PENALTY": "5.0",
    "DR_OA_NUMBER_OF_OBSTACLES": "6",
    "DR_OA_PSEUDO_RANDOMIZE_OBSTACLE_LOCATIONS": "False",
    "DR_OA_NUMBER_OF_PSEUDO_RANDOM_PLACEMENTS": "2",
    "DR_LOCAL_S3_PRETRAINED": "False",
    "DR_LOCAL_S3_PRETRAINED_PREFIX": "rl-sagemaker-pretrained",
    "DR_LOCAL_S3_MODEL_PREFIX": "rl-deepracer-sagemaker",
    "DR_LOCAL_S3_BUCKET": "bucket",
    "DR_LOCAL_S3_CUSTOM_FILES_PREFIX": "custom_files",
    "DR_LOCAL_S3_PARAMS_FILE": "deepracer-sagemaker-params.yaml",
    "DR_LOCAL_S3_EVAL_PARAMS_FILE": "eval-params.yaml",
    "DR_LOCAL_S3_TOURNAMENT_JSON_FILE": "tournament.json",
    "DR_LOCAL_S3_TOURNAMENT_PARAMS_FILE": "tournament_params.yaml",
    "DR_LOCAL_S3_MODEL_METADATA_KEY": "$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/model_metadata.json",
    "DR_LOCAL_S3_HYPERPARAMETERS_KEY": "$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/hyperparameters.json",
    "DR_LOCAL_S3_REWARD_KEY": "$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/reward_function.py",
    "DR_LOCAL_S3_METRICS_KEY": "$DR_LOCAL_S3_MODEL_PREFIX/metrics/training_metrics.json",
}
"""What a run.env of the first year holds."""

SYSTEM_2021 = {
    "DR_CLOUD": "local",
    "DR_AWS_APP_REGION": "us-east-1",
    "DR_UPLOAD_S3_PROFILE": "default",
    "DR_UPLOAD_S3_BUCKET": "not-defined",
    "DR_UPLOAD_S3_ROLE": "to-be-defined",
    "DR_LOCAL_S3_BUCKET": "bucket",
    "DR_LOCAL_S3_PROFILE": "minio",
    "DR_GUI_ENABLE": "False",
    "DR_KINESIS_STREAM_NAME": "",
    "DR_KINESIS_STREAM_ENABLE": "True",
    "DR_CAMERA_MAIN_ENABLE": "True",
    "DR_SAGEMAKER_IMAGE": "5.1.0-gpu",
    "DR_ROBOMAKER_IMAGE": "5.1.0-cpu-avx2",
    "DR_ROBOMAKER_IMAGE_TYPE": "cpu",
    "DR_COACH_IMAGE": "5.1.0",
    "DR_MINIO_IMAGE": "latest",
    "DR_WORKERS": "1",
    "DR_ROBOMAKER_MOUNT_LOGS": "False",
    "DR_CLOUD_WATCH_ENABLE": "False",
    "DR_DOCKER_STYLE": "swarm",
    "DR_HOST_X": "False",
    "DR_WEBVIEWER_PORT": "8100",
}
"""What a system.env held from 2021 to April 2026."""


def lines(values: dict[str, str]) -> str:
    return "".join(f"{name}={value}\n" for name, value in values.items())


def test_a_folder_of_earlier_years_is_accepted_and_nothing_in_it_is_unknown(folder):
    folder.write("system.env", lines(SYSTEM_2021))
    folder.write("run.env", lines(RUN_2020))

    report = check_settings(folder.path, environ={})

    assert ["LGSWide is a community track" in str(error) for error in report.errors] == [True]
    assert not [text for text in report.warnings if "is the old name of" not in text]
    idle = {name for group in report.without_effect for name in group.names}
    assert {*RUN_2020, *SYSTEM_2021} <= idle | set(catalogue()) | set(old_names())


def test_names_of_earlier_years_that_mean_a_setting_are_obeyed(folder):
    settings = folder.load("DR_EVAL_NUMBER_OF_RESETS=7\nDR_LOCAL_S3_PARAMS_FILE=params.yaml\n")

    assert (settings.eval_max_resets, settings.training_params_file) == (7, "params.yaml")


@pytest.mark.parametrize("name", sorted(FORMER))
def test_a_former_name_is_no_setting_and_no_misspelling(folder, name):
    settings = folder.load(f"{name}=0.05\n")

    assert name not in catalogue()
    assert not any("is not a setting" in text for text in settings.warnings)


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("DR_TARGET_REWARD_SCORE=500", "DR_TRAIN_STOP_MEAN_SCORE ends a training by its reward"),
        ("DR_NUMBER_OF_EPISODES=100", "DR_TRAIN_MAX_ITERATIONS"),
        ("DR_OA_PSEUDO_RANDOMIZE_OBSTACLE_LOCATIONS=True", "DR_OA_OBJECT_POSITIONS fixes them"),
        ("DR_TRAIN_ALTERNATE_DRIVI=True", "write DR_TRAIN_ALTERNATE_DRIVING_DIRECTION"),
    ],
)
def test_who_counts_on_a_former_name_is_told(folder, line, part):
    (warning,) = folder.load(f"{line}\n").warnings

    assert warning.startswith(f"run.env line 1: {line} has no effect: ")
    assert part in warning


def test_a_former_name_is_shown_with_its_reason_and_its_secrets_stay_hidden(folder):
    settings = folder.load("DR_LOCAL_SECRET_ACCESS_KEY=hush\nDR_UPLOAD_S3_ROLE=arn:me\n")

    shown = {value.name: value for value in inspect_values(settings).settings}

    assert shown["DR_LOCAL_SECRET_ACCESS_KEY"].value == "(hidden)"
    assert shown["DR_UPLOAD_S3_ROLE"].value == "arn:me"
    assert "imported into the console" in shown["DR_UPLOAD_S3_ROLE"].reason


def test_other_values_may_refer_to_a_former_name(folder):
    settings = folder.load("DR_UPLOAD_MODEL_NAME=comet\nDR_UPLOAD_S3_PREFIX=$DR_UPLOAD_MODEL_NAME")

    assert settings.upload_s3_prefix == "comet"


def test_a_shell_of_an_earlier_version_makes_no_noise(folder):
    environ = {
        "DR_UPLOAD_PROFILE": "--profile default",
        "DR_TRAIN_COMPOSE_FILE": "-f a.yml",
        "DR_LOCAL_SECRET_ACCESS_KEY": "hush",
    }

    settings = folder.load("", environ=environ)

    assert settings.warnings == ()
    assert "hush" not in repr(settings.run)


def test_a_misspelt_name_in_the_environment_refuses_nothing(folder):
    settings = folder.load("", environ={"DR_WORLD_NAMES": "bean"})

    (warning,) = settings.warnings
    assert "DR_WORLD_NAMES (did you mean DR_WORLD_NAME?)" in warning


@pytest.mark.skipif(not ALL_NAMES.exists(), reason="the list of names is not beside the project")
def test_every_name_that_the_reference_ever_used_is_known():
    names = {line.strip() for line in ALL_NAMES.read_text().splitlines() if line[:3] == "DR_"}

    unknown = names - set(catalogue()) - set(old_names()) - set(FORMER)

    assert len(names) > 150
    assert unknown == set()
