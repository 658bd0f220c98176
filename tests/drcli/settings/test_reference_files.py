"""Files written for the reference load as they are, and damaged ones never crash."""

import contextlib
from pathlib import Path

from hypothesis import given
from hypothesis import settings as limits
from hypothesis import strategies as st

from drcli.config import Settings, catalogue, load_settings
from drcli.errors import SettingsError

# The reference's own run.env and system.env, as its installer writes them.
REFERENCE_RUN = """
DR_RUN_ID=0
DR_WORLD_NAME=reinvent_base
DR_RACE_TYPE=TIME_TRIAL
DR_CAR_NAME=FastCar
DR_CAR_BODY_SHELL_TYPE=deepracer
DR_CAR_COLOR=Red
DR_DISPLAY_NAME=$DR_CAR_NAME
DR_RACER_NAME=$DR_CAR_NAME
DR_ENABLE_DOMAIN_RANDOMIZATION=False
DR_EVAL_NUMBER_OF_TRIALS=3
DR_EVAL_IS_CONTINUOUS=True
DR_EVAL_MAX_RESETS=100
DR_EVAL_OFF_TRACK_PENALTY=5.0
DR_EVAL_COLLISION_PENALTY=5.0
DR_EVAL_SAVE_MP4=False
DR_EVAL_CHECKPOINT=last
DR_EVAL_OPP_S3_MODEL_PREFIX=rl-deepracer-sagemaker
DR_EVAL_OPP_CAR_BODY_SHELL_TYPE=deepracer
DR_EVAL_OPP_CAR_NAME=FasterCar
DR_EVAL_OPP_DISPLAY_NAME=$DR_EVAL_OPP_CAR_NAME
DR_EVAL_OPP_RACER_NAME=$DR_EVAL_OPP_CAR_NAME
DR_EVAL_DEBUG_REWARD=False
DR_EVAL_RESET_BEHIND_DIST=1.0
DR_EVAL_REVERSE_DIRECTION=False
#DR_EVAL_RTF=1.0
DR_TRAIN_CHANGE_START_POSITION=True
DR_TRAIN_ALTERNATE_DRIVING_DIRECTION=False
DR_TRAIN_START_POSITION_OFFSET=0.0
DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST=0.05
DR_TRAIN_REVERSE_DIRECTION=False
DR_TRAIN_MULTI_CONFIG=False
DR_TRAIN_MIN_EVAL_TRIALS=5
DR_TRAIN_BEST_MODEL_METRIC=progress
#DR_TRAIN_RTF=1.0
#DR_TRAIN_MAX_STEPS_PER_ITERATION=10000
DR_LOCAL_S3_MODEL_PREFIX=rl-deepracer-sagemaker
DR_LOCAL_S3_PRETRAINED=False
DR_LOCAL_S3_PRETRAINED_PREFIX=rl-sagemaker-pretrained
DR_LOCAL_S3_PRETRAINED_CHECKPOINT=last
DR_LOCAL_S3_CUSTOM_FILES_PREFIX=custom_files
DR_LOCAL_S3_TRAINING_PARAMS_FILE=training_params.yaml
DR_LOCAL_S3_EVAL_PARAMS_FILE=evaluation_params.yaml
DR_LOCAL_S3_MODEL_METADATA_KEY=$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/model_metadata.json
DR_LOCAL_S3_HYPERPARAMETERS_KEY=$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/hyperparameters.json
DR_LOCAL_S3_REWARD_KEY=$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/reward_function.py
DR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/metrics
DR_UPLOAD_S3_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX-1
DR_OA_NUMBER_OF_OBSTACLES=6
DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES=2.0
DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS=False
DR_OA_IS_OBSTACLE_BOT_CAR=False
DR_OA_OBSTACLE_TYPE=box_obstacle
DR_OA_OBJECT_POSITIONS=
DR_H2B_IS_LANE_CHANGE=False
DR_H2B_LOWER_LANE_CHANGE_TIME=3.0
DR_H2B_UPPER_LANE_CHANGE_TIME=5.0
DR_H2B_LANE_CHANGE_DISTANCE=1.0
DR_H2B_NUMBER_OF_BOT_CARS=3
DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS=2.0
DR_H2B_RANDOMIZE_BOT_CAR_LOCATIONS=False
DR_H2B_BOT_CAR_SPEED=0.2
DR_H2B_BOT_CAR_PENALTY=5.0
"""
REFERENCE_SYSTEM = """
DR_CLOUD=local
DR_AWS_APP_REGION=us-east-1
DR_UPLOAD_S3_PROFILE=default
DR_UPLOAD_S3_BUCKET=not-defined
DR_LOCAL_S3_BUCKET=bucket
DR_LOCAL_S3_PROFILE=minio
DR_GUI_ENABLE=False
DR_KINESIS_STREAM_NAME=
DR_CAMERA_MAIN_ENABLE=True
DR_CAMERA_SUB_ENABLE=False
DR_CAMERA_KVS_ENABLE=True
DR_ENABLE_EXTRA_KVS_OVERLAY=False
DR_SIMAPP_SOURCE=awsdeepracercommunity/deepracer-simapp
DR_SIMAPP_VERSION=6.0.4-gpu
DR_MINIO_IMAGE=latest
DR_ANALYSIS_IMAGE=cpu
DR_WORKERS=1
DR_ROBOMAKER_MOUNT_LOGS=False
# DR_ROBOMAKER_MOUNT_SIMAPP_DIR=
DR_CLOUD_WATCH_ENABLE=False
DR_CLOUD_WATCH_LOG_STREAM_PREFIX=
DR_DOCKER_STYLE=swarm
DR_HOST_X=False
DR_WEBVIEWER_PORT=8100
DR_QUIET_ACTIVATE=False
# DR_REMOTE_MINIO_URL=http://mynas:9000
"""


def test_the_files_of_the_reference_load_without_a_warning(folder):
    folder.write("system.env", REFERENCE_SYSTEM)

    settings = folder.load(REFERENCE_RUN)

    assert settings.warnings == ()
    assert settings.extra == {}
    assert settings.metrics_prefix == "rl-deepracer-sagemaker/metrics"
    assert settings.reward_key == "custom_files/reward_function.py"
    assert settings.display_name == "FastCar"
    assert settings.upload_s3_prefix == "rl-deepracer-sagemaker-1"


def test_the_defaults_are_the_values_of_the_reference(folder):
    written = folder.load(REFERENCE_RUN)

    silent = folder.load("")

    changed = {"sources"}
    assert silent.model_dump(exclude=changed) == written.model_dump(exclude=changed)


def test_the_examples_of_the_project_load_without_a_warning():
    root = Path(__file__).resolve().parents[3]

    settings = load_settings(root, environ={})

    assert settings.warnings == ()
    assert settings.workers == 1


def test_a_flag_moves_what_the_files_derive_from_its_name(folder):
    settings = folder.load(REFERENCE_RUN, flags={"DR_LOCAL_S3_MODEL_PREFIX": "other"})

    assert settings.metrics_prefix == "other/metrics"


@limits(max_examples=60)
@given(data=st.data())
def test_a_damaged_file_is_loaded_or_refused_and_nothing_else(folder, data):
    text = REFERENCE_RUN.encode()
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        junk = data.draw(st.binary(max_size=6) | st.sampled_from([b"$", b"=", b"'", b"\n", b"${"]))
        text = text[:at] + junk + text[at + data.draw(st.integers(0, 30)) :]

    with contextlib.suppress(SettingsError):
        settings = folder.load(text)

        assert Settings.restore(settings.dump()) == settings


@limits(max_examples=60)
@given(
    st.dictionaries(
        st.sampled_from(sorted(catalogue())),
        st.text(st.characters(exclude_characters="\0"), max_size=12),
        max_size=5,
    )
)
def test_any_environment_is_accepted_or_refused_and_nothing_else(environ):
    root = Path(__file__).resolve().parents[3]

    with contextlib.suppress(SettingsError):
        settings = load_settings(root, environ=environ)

        assert Settings.restore(settings.dump()) == settings
