"""Settings: where a value comes from, what is refused, and in which words."""

import contextlib
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
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


class Folder:
    """A folder with a run.env and a system.env."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.write("system.env", "")

    def write(self, name: str, text: str | bytes) -> None:
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())

    def load(self, run: str | bytes, **options) -> Settings:
        self.write("run.env", run)
        return load_settings(self.path, **{"environ": {}, **options})

    def refusal(self, run: str | bytes, **options) -> SettingsError:
        with pytest.raises(SettingsError) as caught:
            self.load(run, **options)
        return caught.value


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


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
    root = Path(__file__).resolve().parents[2]

    settings = load_settings(root, environ={})

    assert settings.warnings == ()
    assert settings.workers == 1


@pytest.mark.parametrize("layers", [4, 3, 2, 1, 0])
def test_the_strongest_layer_wins(folder, layers):
    given = ["flag", "environment", "run.env line 1", "system.env line 1", "default"][4 - layers :]
    if "system.env line 1" in given:
        folder.write("system.env", "DR_WORKERS=5")

    settings = folder.load(
        "DR_WORKERS=4" if "run.env line 1" in given else "",
        environ={"DR_WORKERS": "3"} if "environment" in given else {},
        flags={"DR_WORKERS": "2"} if "flag" in given else {},
    )

    assert settings.source("DR_WORKERS") == given[0]
    assert settings.workers == 6 - layers if layers else settings.workers == 1


@pytest.mark.parametrize("text", ["true", "True", "TRUE", "yes", "Y", "1", "t", "on"])
def test_many_spellings_mean_true(folder, text):
    settings = folder.load(f"DR_TRAIN_REVERSE_DIRECTION={text}")

    assert settings.train_reverse_direction is True


@pytest.mark.parametrize("text", ["false", "False", "no", "N", "0", "f", "off"])
def test_many_spellings_mean_false(folder, text):
    settings = folder.load(f"DR_EVAL_IS_CONTINUOUS={text}")

    assert settings.eval_is_continuous is False


def test_words_are_matched_in_any_letter_case(folder):
    settings = folder.load("DR_RACE_TYPE=time_trial\nDR_EVAL_CHECKPOINT=Best\nDR_CAR_COLOR=blue")

    assert (settings.race_type, settings.eval_checkpoint) == ("TIME_TRIAL", "best")
    assert settings.car_color == "Blue"


@pytest.mark.parametrize("name", ["DR_WORKERS", "DR_EVAL_IS_CONTINUOUS", "DR_TRAIN_SEED"])
def test_an_empty_value_means_not_set(folder, name):
    folder.write("system.env", f"{name}=1")

    settings = folder.load(f"{name}=")

    assert settings.source(name) == "system.env line 1"


def test_names_are_filled_in_across_files_and_environment(folder):
    folder.write("system.env", "DR_LOCAL_S3_BUCKET=$HOME_BUCKET\nTEAM=blue\n")

    settings = folder.load(
        "DR_LOCAL_S3_MODEL_PREFIX=${TEAM}/$DR_WORLD_NAME-1\nDR_WORLD_NAME=Oval_track\n",
        environ={"HOME_BUCKET": "racing"},
    )

    assert settings.bucket == "racing"
    assert settings.model_prefix == "blue/Oval_track-1"
    assert settings.metrics_prefix == "blue/Oval_track-1/metrics"
    assert settings.extra == {"TEAM": "blue"}
    assert settings.warnings == ()


def test_a_flag_moves_what_the_files_derive_from_its_name(folder):
    settings = folder.load(REFERENCE_RUN, flags={"DR_LOCAL_S3_MODEL_PREFIX": "other"})

    assert settings.metrics_prefix == "other/metrics"


def test_a_name_that_refers_to_itself_means_the_layer_below(folder):
    folder.write("system.env", "DR_LOCAL_S3_MODEL_PREFIX=team")

    settings = folder.load("DR_LOCAL_S3_MODEL_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/one")

    assert settings.model_prefix == "team/one"


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("DR_CAR_NAME='$HOME'", "$HOME"),
        (r"DR_CAR_NAME=\$HOME", "$HOME"),
        ("DR_CAR_NAME=${NOBODY:-Comet}", "Comet"),
        ("DR_CAR_NAME=5$", "5$"),
        ("DR_CAR_NAME=a b=c", "a b=c"),
    ],
)
def test_dollar_signs_and_spaces_survive_where_they_should(folder, written, name):
    assert folder.load(written, environ={"HOME": "x"}).car_name == name


@pytest.mark.parametrize(
    ("line", "sentence", "remedy"),
    [
        pytest.param(
            "DR_WORKERS=abc",
            "run.env line 2: DR_WORKERS=abc is no whole number.",
            "Set DR_WORKERS to a whole number from 1 to 10, or leave it out for the default 1.",
            id="not-a-whole-number",
        ),
        pytest.param(
            "DR_WORKERS=2.5",
            "run.env line 2: DR_WORKERS=2.5 is no whole number.",
            "Set DR_WORKERS to a whole number from 1 to 10, or leave it out for the default 1.",
            id="fraction-of-a-worker",
        ),
        pytest.param(
            "DR_WORKERS=11",
            "run.env line 2: DR_WORKERS=11 is above 10.",
            "Set DR_WORKERS to a whole number from 1 to 10, or leave it out for the default 1.",
            id="too-large",
        ),
        pytest.param(
            "DR_EVAL_OFF_TRACK_PENALTY=-1",
            "run.env line 2: DR_EVAL_OFF_TRACK_PENALTY=-1 is below 0.",
            "Set DR_EVAL_OFF_TRACK_PENALTY to a number, 0 or more, "
            "or leave it out for the default 5.0.",
            id="too-small",
        ),
        pytest.param(
            "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST=5 %",
            "run.env line 2: DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST=5 % is no number.",
            "Set DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST to a number from 0 to 1, "
            "or leave it out for the default 0.05.",
            id="not-a-number",
        ),
        pytest.param(
            "DR_EVAL_COLLISION_PENALTY=nan",
            "run.env line 2: DR_EVAL_COLLISION_PENALTY=nan is no number.",
            "Set DR_EVAL_COLLISION_PENALTY to a number, 0 or more, "
            "or leave it out for the default 5.0.",
            id="nan",
        ),
        pytest.param(
            "DR_EVAL_IS_CONTINUOUS=maybe",
            "run.env line 2: DR_EVAL_IS_CONTINUOUS=maybe is neither True nor False.",
            "Set DR_EVAL_IS_CONTINUOUS to True or False, or leave it out for the default True.",
            id="not-a-flag",
        ),
        pytest.param(
            "DR_RACE_TYPE=TIMETRIAL",
            "run.env line 2: DR_RACE_TYPE=TIMETRIAL is none of TIME_TRIAL, OBJECT_AVOIDANCE, "
            "HEAD_TO_BOT, HEAD_TO_MODEL.",
            "Did you mean TIME_TRIAL? Write one of TIME_TRIAL, OBJECT_AVOIDANCE, HEAD_TO_BOT, "
            "HEAD_TO_MODEL.",
            id="unknown-choice",
        ),
        pytest.param(
            "DR_WORKER=2",
            "run.env line 2: DR_WORKER=2 is no setting.",
            "Did you mean DR_WORKERS? Correct the name, or remove the line.",
            id="misspelt-name",
        ),
        pytest.param(
            "dr_world_name=Oval_track",
            "run.env line 2: dr_world_name=Oval_track is no setting.",
            "Did you mean DR_WORLD_NAME? Correct the name, or remove the line.",
            id="name-in-small-letters",
        ),
        pytest.param(
            "DR_WORLD_NAME=two tracks",
            "run.env line 2: DR_WORLD_NAME=two tracks cannot be the name of a track.",
            "Write a name such as reinvent_base, or the path of a .npy file.",
            id="no-track-name",
        ),
        pytest.param(
            "DR_LOCAL_S3_MODEL_PREFIX=/model",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=/model has an empty part, . or .. between "
            "its slashes.",
            "Write folders as in team/model-1, without / at the start or the end.",
            id="prefix-with-leading-slash",
        ),
        pytest.param(
            "DR_LOCAL_S3_MODEL_PREFIX=my model",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=my model holds ' ', which cannot stand in "
            "a name in the bucket.",
            "Use only letters, digits, and the characters . _ - /.",
            id="prefix-with-space",
        ),
        pytest.param(
            "DR_LOCAL_S3_MODEL_PREFIX=",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX= is empty.",
            "Write a name such as rl-deepracer-1.",
            id="empty-prefix",
        ),
        pytest.param(
            "DR_LOCAL_S3_BUCKET=s3://bucket",
            "run.env line 2: DR_LOCAL_S3_BUCKET=s3://bucket is no name of a bucket.",
            "Write its plain name of 3 to 63 letters, digits, dots and hyphens, without s3://.",
            id="bucket-as-address",
        ),
        pytest.param(
            "DR_REMOTE_MINIO_URL=mynas:9000",
            "run.env line 2: DR_REMOTE_MINIO_URL=mynas:9000 is no web address.",
            "Write it as in http://192.168.1.5:9000.",
            id="address-without-scheme",
        ),
        pytest.param(
            "DR_CLOUD=remote",
            "run.env line 2: DR_CLOUD=remote needs an address, but DR_REMOTE_MINIO_URL is empty.",
            "Set DR_REMOTE_MINIO_URL, as in http://192.168.1.5:9000, or write DR_CLOUD=local.",
            id="remote-without-address",
        ),
        pytest.param(
            "DR_LOCAL_S3_PRETRAINED=True\nDR_LOCAL_S3_PRETRAINED_PREFIX=rl-deepracer-sagemaker",
            "run.env line 3: DR_LOCAL_S3_PRETRAINED_PREFIX=rl-deepracer-sagemaker is the model "
            "to train.",
            "Give DR_LOCAL_S3_MODEL_PREFIX a new name, such as rl-deepracer-sagemaker-clone.",
            id="clone-onto-itself",
        ),
        pytest.param(
            "DR_CAR_NAME=$TEAM",
            "run.env line 2: DR_CAR_NAME=$TEAM refers to TEAM, which is set nowhere.",
            "Set TEAM in system.env or in the environment, or write the value itself.",
            id="reference-to-nothing",
        ),
        pytest.param(
            "DR_CAR_NAME=$A\nA=$DR_CAR_NAME",
            "run.env line 3: A=$DR_CAR_NAME refers in a circle or through too many names "
            "(DR_CAR_NAME).",
            "Write the value of A itself.",
            id="circle",
        ),
        pytest.param(
            "DR_CAR_NAME",
            "run.env line 2: DR_CAR_NAME has no =.",
            "Write NAME=value, or start the line with # if it is a comment.",
            id="no-equal-sign",
        ),
        pytest.param(
            "DR_EXPERIMENT_NAME=first",
            "run.env line 2: DR_EXPERIMENT_NAME=first comes too late to choose a run.env.",
            "Move the line to system.env.",
            id="experiment-in-run-env",
        ),
        pytest.param(
            'DR_CAR_NAME="a\\nb"',
            "run.env line 2: DR_CAR_NAME='a\\nb' holds a line break or control character.",
            "Remove it from DR_CAR_NAME.",
            id="line-break",
        ),
    ],
)
def test_a_bad_line_is_named_with_file_line_key_value_and_remedy(folder, line, sentence, remedy):
    refusal = folder.refusal(f"# top\n{line}\n")

    assert str(refusal) == sentence
    assert refusal.remedy == remedy
    assert refusal.code == 3


def test_everything_wrong_is_reported_at_once_in_the_order_of_reading(folder):
    folder.write("system.env", "DR_CLOUD=lokal\n")

    refusal = folder.refusal("DR_WORKERS=0\nDR_WORLDNAME=x\nDR_EVAL_MAX_RESETS=-1\n")

    assert str(refusal).splitlines() == [
        "run.env line 1: DR_WORKERS=0 is below 1.",
        "run.env line 2: DR_WORLDNAME=x is no setting.",
        "run.env line 3: DR_EVAL_MAX_RESETS=-1 is below 0.",
        "system.env line 1: DR_CLOUD=lokal is none of local, remote, aws, azure.",
    ]
    assert "Did you mean local?" in refusal.remedy


def test_what_follows_from_a_mistake_is_not_reported_again(folder):
    refusal = folder.refusal(
        "DR_LOCAL_S3_MODEL_PREFIX=my model\n"
        "DR_LOCAL_S3_METRICS_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX/metrics\n"
    )

    assert str(refusal).count("\n") == 0


@pytest.mark.parametrize("lines", ["DR_CAR_NAME=$A\nA=$B\n", "A=$B\nDR_CAR_NAME=$A-$A\n"])
def test_a_gap_further_down_is_reported_where_it_is(folder, lines):
    refusal = folder.refusal(lines)

    line = lines.splitlines().index("A=$B") + 1
    assert str(refusal) == f"run.env line {line}: A=$B refers to B, which is set nowhere."


def test_settings_that_refer_to_each_other_in_a_circle_are_refused(folder):
    refusal = folder.refusal("DR_CAR_NAME=$DR_RACER_NAME\nDR_RACER_NAME=$DR_CAR_NAME\n")

    assert "refers in a circle" in str(refusal)


def test_names_that_multiply_each_other_cannot_fill_the_memory(folder):
    lines = [f"A{k}=$A{k + 1}$A{k + 1}$A{k + 1}$A{k + 1}" for k in range(15)]

    refusal = folder.refusal("\n".join([*lines, "A15=xxxx", "DR_CAR_NAME=$A0"]))

    assert "grows beyond 4096 characters once filled in" in str(refusal)


def test_a_filled_in_value_is_shown_with_what_was_written(folder):
    refusal = folder.refusal("N=many\nDR_WORKERS=$N")

    assert str(refusal) == "run.env line 2: DR_WORKERS=many is no whole number (written $N)."


@pytest.mark.parametrize("layer", ["environ", "flags"])
def test_a_mistake_outside_the_files_names_its_place(folder, layer):
    refusal = folder.refusal("", **{layer: {"DR_WORKERS": "all"}})

    place = {"environ": "environment", "flags": "flag"}[layer]
    assert str(refusal) == f"{place}: DR_WORKERS=all is no whole number."


def test_unknown_names_are_kept_with_a_warning(folder):
    settings = folder.load("AWS_PROFILE=me\nDR_SOMETHING_ELSE_ENTIRELY=1\nWORLD_NAME=x\n")

    assert settings.extra == {
        "AWS_PROFILE": "me",
        "DR_SOMETHING_ELSE_ENTIRELY": "1",
        "WORLD_NAME": "x",
    }
    assert settings.warnings == (
        "run.env line 1: AWS_PROFILE is no setting and has no effect.",
        "run.env line 2: DR_SOMETHING_ELSE_ENTIRELY is no setting and has no effect.",
        "run.env line 3: WORLD_NAME is no setting and has no effect. Did you mean DR_WORLD_NAME?",
    )


def test_the_environment_of_other_programs_is_left_alone(folder):
    settings = folder.load("", environ={"HOME": "/root", "EDITOR": "vi"})

    assert (settings.extra, settings.warnings) == ({}, ())


@pytest.mark.parametrize(
    ("old", "field", "value"),
    [
        ("DR_CHANGE_START_POSITION=False", "train_change_start_position", False),
        ("DR_ALTERNATE_DRIVING_DIRECTION=True", "train_alternate_driving_direction", True),
        ("DR_COLLISION_PENALTY=2", "eval_collision_penalty", 2.0),
        ("DR_TRAIN_ROUND_ROBIN_ADVANCE_DISTANCE=0.1", "train_round_robin_advance_dist", 0.1),
    ],
)
def test_an_old_name_still_works(folder, old, field, value):
    settings = folder.load(old)

    assert getattr(settings, field) == value
    assert "is the old name of" in settings.warnings[0]


def test_an_old_name_gives_way_to_the_present_one(folder):
    settings = folder.load("DR_EVAL_COLLISION_PENALTY=3\nDR_COLLISION_PENALTY=2")

    assert settings.eval_collision_penalty == 3.0
    assert "ignored, because both are set" in settings.warnings[0]


def test_a_repeated_line_counts_as_last_written(folder):
    settings = folder.load("DR_WORKERS=2\nDR_WORKERS=3\n")

    assert settings.workers == 3
    assert settings.warnings == (
        "run.env line 2: DR_WORKERS stands at run.env line 1 too; the later line counts.",
    )


def test_a_setting_without_effect_is_announced_only_when_somebody_may_count_on_it(folder):
    settings = folder.load("DR_EVAL_SAVE_MP4=yes\nDR_HOST_X=True\nDR_TRAIN_MULTI_CONFIG=no\n")

    assert settings.warnings == (
        "run.env line 1: DR_EVAL_SAVE_MP4=True has no effect: videos are not recorded.",
    )


def test_a_wrong_value_that_has_no_effect_is_only_a_warning(folder):
    settings = folder.load("DR_WEBVIEWER_PORT=8100-8110\n")

    assert settings.webviewer_port == 8100
    assert "DR_WEBVIEWER_PORT=8100-8110 is no whole number" in settings.warnings[0]


@pytest.mark.parametrize("how", ["argument", "environment", "system.env"])
def test_an_experiment_brings_its_own_run_env_and_custom_files(folder, how):
    folder.write("experiments/first/run.env", "DR_WORKERS=7")
    if how == "system.env":
        folder.write("system.env", "DR_EXPERIMENT_NAME=first")

    settings = folder.load(
        "DR_WORKERS=2",
        experiment="first" if how == "argument" else None,
        environ={"DR_EXPERIMENT_NAME": "first"} if how == "environment" else {},
    )

    assert settings.workers == 7
    assert settings.source("DR_WORKERS") == "experiments/first/run.env line 1"
    assert settings.custom_files_dir == folder.path / "experiments" / "first" / "custom_files"


def test_an_experiment_that_does_not_exist_is_refused(folder):
    folder.write("experiments/first/run.env", "")

    refusal = folder.refusal("", experiment="frist")

    assert str(refusal) == ("flag: DR_EXPERIMENT_NAME=frist has no experiments/frist/run.env.")
    assert refusal.remedy == "Did you mean first? Write one of first."


def test_a_folder_without_run_env_is_refused(tmp_path):
    with pytest.raises(SettingsError) as refusal:
        load_settings(tmp_path, environ={})

    assert str(refusal.value) == f"run.env: there is no such file in {tmp_path}."
    assert "dr init" in refusal.value.remedy


def test_a_folder_without_system_env_has_the_defaults_and_a_warning(folder):
    (folder.path / "system.env").unlink()

    settings = folder.load("")

    assert settings.cloud == "local"
    assert "system.env: is missing" in settings.warnings[0]


def test_folders_are_found_from_wherever_a_process_runs(folder):
    settings = folder.load("DR_TRACKS_DIR=my tracks\nDR_S3_DATA_DIR=/srv/s3\n")

    assert settings.tracks_dir == folder.path / "my tracks"
    assert settings.s3_data_dir == Path("/srv/s3")
    assert settings.custom_files_dir == folder.path / "custom_files"


def test_settings_are_the_same_in_another_process(folder):
    settings = folder.load('DR_OA_OBJECT_POSITIONS="0.23,-1;0.46,1"\nTEAM=x\nDR_TRAIN_SEED=4\n')

    restored = Settings.restore(settings.dump())

    assert restored == settings
    assert restored.oa_object_positions == ((0.23, -1.0), (0.46, 1.0))


def test_settings_cannot_be_changed(folder):
    settings = folder.load("")

    with pytest.raises(ValueError, match="frozen"):
        settings.workers = 2  # type: ignore[misc]


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("DR_RACE_TYPE=TIME_TRIAL", None),
        (
            "DR_RACE_TYPE=HEAD_TO_BOT",
            "run.env line 1: DR_RACE_TYPE=HEAD_TO_BOT cannot be driven yet, only TIME_TRIAL can.",
        ),
        (
            "DR_LOCAL_S3_PRETRAINED=True",
            "run.env line 1: DR_LOCAL_S3_PRETRAINED=True cannot be done yet, a training starts "
            "with fresh weights.",
        ),
    ],
)
def test_what_cannot_be_run_yet_is_said_in_one_sentence(folder, line, sentence):
    assert folder.load(line).unsupported() == sentence


def test_an_evaluation_does_not_mind_where_the_weights_came_from(folder):
    assert folder.load("DR_LOCAL_S3_PRETRAINED=True").unsupported("evaluation") is None


def test_every_name_stands_once_with_a_meaning_and_a_default_that_fits():
    fields = [setting.field for setting in catalogue().values()]

    assert len(set(fields)) == len(fields)
    for name, setting in catalogue().items():
        assert name.startswith("DR_")
        assert setting.meaning.endswith(".")
        assert (setting.effect == "used") == (setting.reason == "")


def test_no_two_names_are_so_alike_that_one_passes_for_a_typo_of_an_old_one():
    old_names = [old for setting in catalogue().values() for old in setting.old_names]

    assert not set(old_names) & set(catalogue())


def test_loading_needs_none_of_the_slow_libraries():
    slow = "{'torch', 'numpy', 'mujoco', 'boto3', 'typer', 'rich'}"
    code = f"import sys, drcli.config; print({slow} & set(sys.modules) or '')"

    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)

    assert printed.stdout.strip() == b""


@limits(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
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


@limits(max_examples=60, deadline=None)
@given(
    st.dictionaries(
        st.sampled_from(sorted(catalogue())),
        st.text(st.characters(exclude_characters="\0"), max_size=12),
        max_size=5,
    )
)
def test_any_environment_is_accepted_or_refused_and_nothing_else(environ):
    root = Path(__file__).resolve().parents[2]

    with contextlib.suppress(SettingsError):
        settings = load_settings(root, environ=environ)

        assert Settings.restore(settings.dump()) == settings
