"""Every name of the reference is known, and every setting says what it is."""

import re
from pathlib import Path

import pytest

from drcli.config.fields import hidden
from drcli.config.settings import catalogue

ROOT = Path(__file__).resolve().parents[3]

RUN_NAMES = """
DR_RUN_ID DR_WORLD_NAME DR_RACE_TYPE DR_CAR_NAME DR_CAR_BODY_SHELL_TYPE DR_CAR_COLOR
DR_DISPLAY_NAME DR_RACER_NAME DR_ENABLE_DOMAIN_RANDOMIZATION DR_TRAIN_CHANGE_START_POSITION
DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST DR_TRAIN_START_POSITION_OFFSET
DR_TRAIN_ALTERNATE_DRIVING_DIRECTION DR_TRAIN_REVERSE_DIRECTION DR_TRAIN_MULTI_CONFIG
DR_TRAIN_MIN_EVAL_TRIALS DR_TRAIN_BEST_MODEL_METRIC DR_TRAIN_RTF DR_TRAIN_MAX_STEPS_PER_ITERATION
DR_EVAL_NUMBER_OF_TRIALS DR_EVAL_IS_CONTINUOUS DR_EVAL_MAX_RESETS DR_EVAL_OFF_TRACK_PENALTY
DR_EVAL_COLLISION_PENALTY DR_EVAL_SAVE_MP4 DR_EVAL_CHECKPOINT DR_EVAL_DEBUG_REWARD
DR_EVAL_RESET_BEHIND_DIST DR_EVAL_REVERSE_DIRECTION DR_EVAL_RTF DR_EVAL_OPP_S3_MODEL_PREFIX
DR_EVAL_OPP_CAR_BODY_SHELL_TYPE DR_EVAL_OPP_CAR_NAME DR_EVAL_OPP_DISPLAY_NAME
DR_EVAL_OPP_RACER_NAME DR_EVAL_OPP_S3_METRICS_PREFIX DR_EVAL_OPP_MODEL_PREFIX
DR_LOCAL_S3_MODEL_PREFIX DR_LOCAL_S3_PRETRAINED DR_LOCAL_S3_PRETRAINED_PREFIX
DR_LOCAL_S3_PRETRAINED_CHECKPOINT DR_LOCAL_S3_CUSTOM_FILES_PREFIX DR_LOCAL_S3_TRAINING_PARAMS_FILE
DR_LOCAL_S3_EVAL_PARAMS_FILE DR_LOCAL_S3_MODEL_METADATA_KEY DR_LOCAL_S3_HYPERPARAMETERS_KEY
DR_LOCAL_S3_REWARD_KEY DR_LOCAL_S3_METRICS_PREFIX DR_UPLOAD_S3_PREFIX DR_OA_NUMBER_OF_OBSTACLES
DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS DR_OA_IS_OBSTACLE_BOT_CAR
DR_OA_OBSTACLE_TYPE DR_OA_OBJECT_POSITIONS DR_H2B_IS_LANE_CHANGE DR_H2B_LOWER_LANE_CHANGE_TIME
DR_H2B_UPPER_LANE_CHANGE_TIME DR_H2B_LANE_CHANGE_DISTANCE DR_H2B_NUMBER_OF_BOT_CARS
DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS DR_H2B_RANDOMIZE_BOT_CAR_LOCATIONS DR_H2B_BOT_CAR_SPEED
DR_H2B_BOT_CAR_PENALTY
"""
SYSTEM_NAMES = """
DR_CLOUD DR_AWS_APP_REGION DR_LOCAL_S3_BUCKET DR_LOCAL_S3_PROFILE DR_UPLOAD_S3_PROFILE
DR_UPLOAD_S3_BUCKET DR_WORKERS DR_GUI_ENABLE DR_KINESIS_STREAM_NAME DR_CAMERA_MAIN_ENABLE
DR_CAMERA_SUB_ENABLE DR_CAMERA_KVS_ENABLE DR_ENABLE_EXTRA_KVS_OVERLAY DR_SIMAPP_SOURCE
DR_SIMAPP_VERSION DR_MINIO_IMAGE DR_ANALYSIS_IMAGE DR_ROBOMAKER_MOUNT_LOGS
DR_ROBOMAKER_MOUNT_SIMAPP_DIR DR_ROBOMAKER_MOUNT_SCRIPTS_DIR DR_CLOUD_WATCH_ENABLE
DR_CLOUD_WATCH_LOG_STREAM_PREFIX DR_DOCKER_STYLE DR_HOST_X DR_DISPLAY DR_WEBVIEWER_PORT
DR_QUIET_ACTIVATE DR_REMOTE_MINIO_URL DR_ROBOMAKER_CUDA_DEVICES DR_SAGEMAKER_CUDA_DEVICES
DR_EXPERIMENT_NAME DR_TELEGRAF_HOST DR_TELEGRAF_PORT DR_DROA_URL DR_DROA_USERNAME DR_DROA_DEBUG
DR_GAZEBO_ARGS DR_GAZEBO_RENDER_ENGINE
"""
DERIVED_NAMES = """
DR_DIR DR_CONFIG DR_ROBOMAKER_TRAIN_PORT DR_ROBOMAKER_EVAL_PORT DR_ROBOMAKER_GUI_PORT
DR_LOCAL_S3_ENDPOINT_URL DR_MINIO_URL DR_LOCAL_PROFILE_ENDPOINT_URL DR_LOCAL_S3_AUTH_MODE
DR_CURRENT_PARAMS_FILE
"""
SPOT_NAMES = """
DR_REGULAR_UPLOAD DR_REGULAR_PHYSICAL_MODEL_UPLOAD DR_CONTINUE_ON_SPOT_INTERRUPTION
DR_IMPORT_MODEL_ON_COMPLETION DR_IMPORT_MODEL_REGULAR_UPLOAD DR_S3_URI
"""
OLD_NAMES = """
DR_CHANGE_START_POSITION DR_ALTERNATE_DRIVING_DIRECTION DR_COLLISION_PENALTY
DR_TRAIN_ROUND_ROBIN_ADVANCE_DISTANCE DR_KINESIS_STREAM_ENABLE DR_EVAL_NUMBER_OF_RESETS
DR_LOCAL_S3_PARAMS_FILE DR_TRAIN_STOP_REWARD
"""
GONE_NAMES = "DR_SAGEMAKER_IMAGE DR_ROBOMAKER_IMAGE"
"""Written by scripts for older versions of the reference."""


@pytest.mark.parametrize(
    "names", [RUN_NAMES, SYSTEM_NAMES, DERIVED_NAMES, SPOT_NAMES, GONE_NAMES], ids=lambda n: n[:20]
)
def test_every_name_of_the_reference_is_known(names):
    assert not set(names.split()) - set(catalogue())


def test_every_old_name_leads_to_a_present_one():
    old = {old for setting in catalogue().values() for old in setting.old_names}

    assert old == set(OLD_NAMES.split())


def test_names_belong_in_the_file_in_which_the_reference_has_them():
    wrong = [name for name in RUN_NAMES.split() if catalogue()[name].file != "run.env"]
    wrong += [name for name in SYSTEM_NAMES.split() if catalogue()[name].file != "system.env"]

    assert not wrong


@pytest.mark.parametrize("file", ["run.env", "system.env"])
def test_names_belong_in_the_file_in_which_our_examples_have_them(file):
    written = re.findall(r"^(?:# )?(DR_\w+)=", (ROOT / file).read_text(), re.MULTILINE)

    assert written
    assert [name for name in written if catalogue()[name].file != file] == []


def test_every_setting_that_is_used_is_read_by_some_module():
    modules = [p for p in (ROOT / "drcli").rglob("*.py") if "config" not in p.parts]
    modules += [ROOT / "drcli" / "config" / name for name in ("loading.py", "settings.py")]
    code = "\n".join(path.read_text("utf-8") for path in modules)

    used = [setting for setting in catalogue().values() if setting.effect == "used"]

    read = set(re.findall(r"\.\w+|DR_\w+", code))
    groups = (ROOT / "drcli" / "config" / "groups").glob("*.py")
    read.update(name for path in groups for name in re.findall(r"self(\.\w+)", path.read_text()))
    unread = [s.name for s in used if not {f".{s.field}", s.name} & read]

    assert unread == []


def test_every_setting_says_what_may_be_written():
    vague = [
        name
        for name, setting in catalogue().items()
        if setting.effect == "used" and setting.kind != "text" and "any text" in setting.expected
    ]

    assert vague == []


def test_only_secret_settings_have_the_name_of_a_secret():
    secret = [name for name in catalogue() if hidden(name, "value") != "value"]
    assert secret == ["DR_WEBHOOK_URL"]
