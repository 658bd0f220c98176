"""Where a value comes from and what it becomes."""

import subprocess
import sys
from pathlib import Path

import pytest

from drcli.config.settings import catalogue
from drcli.config.unused_names import harmless_summary
from drcli.outside.droa.droa_site import PASSWORD_VARIABLE


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


IDLE = [
    ("DR_OA_NUMBER_OF_OBSTACLES=many", "", "DR_RACE_TYPE=OBJECT_AVOIDANCE"),
    ("DR_OA_OBJECT_POSITIONS=left", "DR_RACE_TYPE=HEAD_TO_BOT", "DR_RACE_TYPE=OBJECT_AVOIDANCE"),
    ("DR_H2B_IS_LANE_CHANGE=perhaps", "DR_RACE_TYPE=TIME_TRIAL", "DR_RACE_TYPE=HEAD_TO_BOT"),
    ("DR_LOCAL_S3_PRETRAINED_PREFIX=not yet", "", "DR_LOCAL_S3_PRETRAINED=True"),
]


def test_lane_changes_of_bots_that_no_race_has_are_not_compared(folder):
    assert folder.load("DR_H2B_UPPER_LANE_CHANGE_TIME=2.0").warnings == ()


@pytest.mark.parametrize("upload", ["DR_REGULAR_UPLOAD=60", "DR_UPLOAD_BEST_MODEL=True"])
def test_a_place_of_uploads_that_is_not_set_matters_only_to_uploads(folder, upload):
    line = "DR_UPLOAD_S3_BUCKET=$TEAM_BUCKET"

    [warning] = folder.load(line).warnings

    assert "TEAM_BUCKET, which is not set" in warning
    assert "no upload is asked for" in warning
    assert line in str(folder.refusal(f"{line}\n{upload}"))


@pytest.mark.parametrize(("line", "idle", "used"), IDLE)
def test_a_wrong_value_that_nothing_reads_is_a_warning(folder, line, idle, used):
    [warning] = folder.load(f"{idle}\n{line}\n").warnings

    assert "run.env line 2" in warning
    assert "It has no effect with DR_" in warning
    assert line in str(folder.refusal(f"{used}\n{line}\n"))


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


def test_unknown_names_are_kept_with_a_warning(folder):
    settings = folder.load("AWS_PROFILE=me\nDR_SOMETHING_ELSE_ENTIRELY=1\nWORLD_NAME=x\n")

    assert settings.extra == {
        "AWS_PROFILE": "me",
        "DR_SOMETHING_ELSE_ENTIRELY": "1",
        "WORLD_NAME": "x",
    }
    assert settings.warnings == (
        "run.env line 1: AWS_PROFILE is not a setting and has no effect.",
        "run.env line 2: DR_SOMETHING_ELSE_ENTIRELY is not a setting and has no effect.",
        "run.env line 3: WORLD_NAME is not a setting and has no effect. "
        "Did you mean DR_WORLD_NAME?",
    )


def test_names_that_only_the_environment_has_share_one_warning(folder):
    settings = folder.load("", environ={"DR_XAUTHORITY": "a", "DR_WORKER": "4"})

    assert settings.warnings == (
        "environment: unknown names without effect: DR_XAUTHORITY, "
        "DR_WORKER (did you mean DR_WORKERS?).",
    )
    assert settings.workers == 1


def test_what_commands_read_from_the_environment_is_not_called_without_effect(folder):
    names = {"DR_CAR_PASSWORD": "a", PASSWORD_VARIABLE: "b", "DR_DEBUG": "1"}

    assert folder.load("", environ=names).warnings == ()


def test_the_content_of_a_file_can_be_tried_before_it_is_written(folder):
    settings = folder.load("DR_WORKERS=2", contents={"run.env": b"# new\nDR_WORKERS=3"})

    assert (settings.workers, settings.source("DR_WORKERS")) == (3, "run.env line 2")


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


@pytest.mark.parametrize("both", ["", "DR_CAMERA_KVS_ENABLE=True\n"])
def test_an_old_name_of_a_setting_without_effect_is_not_worth_a_line_of_its_own(folder, both):
    settings = folder.load(f"{both}DR_KINESIS_STREAM_ENABLE=True\n")

    assert settings.warnings == ()
    assert "1 of the settings is for containers" in str(harmless_summary(settings))


def test_a_repeated_line_counts_as_last_written(folder):
    settings = folder.load("DR_WORKERS=2\nDR_WORKERS=3\n")

    assert settings.workers == 3
    assert settings.warnings == (
        "run.env line 2: DR_WORKERS is also set at run.env line 1; the later line counts.",
    )


def test_a_wrong_value_that_has_no_effect_is_only_a_warning(folder):
    settings = folder.load("DR_ROBOMAKER_MOUNT_LOGS=often\n")

    assert settings.robomaker_mount_logs is False
    assert "DR_ROBOMAKER_MOUNT_LOGS=often is neither True nor False" in settings.warnings[0]


def test_a_wrong_value_without_effect_leaves_whole_settings_behind(folder, travelled):
    settings = folder.load("DR_ROBOMAKER_MOUNT_LOGS=often\nDR_GAZEBO_ARGS=$NOBODY/x\n")

    assert settings.robomaker_mount_logs is False
    assert settings.gazebo_args == ""
    assert travelled(settings.run) == settings.run
    assert len(settings.warnings) == 2


@pytest.mark.parametrize("how", ["flag", "environment", "system.env"])
def test_an_experiment_brings_its_own_run_env_and_custom_files(folder, how):
    folder.write("experiments/first/run.env", "DR_WORKERS=7")
    if how == "system.env":
        folder.write("system.env", "DR_EXPERIMENT_NAME=first")

    settings = folder.load(
        "DR_WORKERS=2",
        flags={"DR_EXPERIMENT_NAME": "first"} if how == "flag" else {},
        environ={"DR_EXPERIMENT_NAME": "first"} if how == "environment" else {},
    )

    assert settings.workers == 7
    assert settings.source("DR_WORKERS") == "experiments/first/run.env line 1"
    assert settings.custom_files_dir == folder.path / "experiments" / "first" / "custom_files"


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


def test_a_run_is_the_same_in_another_process(folder, travelled):
    settings = folder.load('DR_OA_OBJECT_POSITIONS="0.23,-1;0.46,1"\nTEAM=x\nDR_TRAIN_SEED=4\n')

    restored = travelled(settings.run)

    assert restored == settings.run
    assert restored.race().oa_object_positions == ((0.23, -1.0), (0.46, 1.0))
    assert restored.train.train_seed == 4


def test_settings_cannot_be_changed(folder):
    settings = folder.load("")

    with pytest.raises(AttributeError, match="frozen"):
        settings.workers = 2


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("DR_RACE_TYPE=TIME_TRIAL", ""),
        ("DR_RACE_TYPE=OBJECT_AVOIDANCE", ""),
        ("DR_RACE_TYPE=HEAD_TO_BOT", ""),
        (
            "DR_RACE_TYPE=HEAD_TO_MODEL",
            "run.env line 1: DR_RACE_TYPE=HEAD_TO_MODEL races two trained models; it is for "
            "evaluations only.",
        ),
        ("DR_LOCAL_S3_PRETRAINED=True", ""),
    ],
)
def test_a_race_without_training_is_explained_in_one_sentence(folder, line, sentence):
    assert str(folder.load(line).untrainable or "") == sentence


def test_every_name_stands_once_with_a_meaning_and_a_default_that_fits():
    fields = [setting.field for setting in catalogue().values()]

    assert len(set(fields)) == len(fields)
    for name, setting in catalogue().items():
        assert name.startswith("DR_")
        assert setting.meaning.endswith(".")
        assert (setting.effect == "used") == (setting.reason == "")
        assert setting.reason == setting.reason.rstrip(".")


def test_no_two_names_are_so_alike_that_one_passes_for_a_typo_of_an_old_one():
    old_names = [old for setting in catalogue().values() for old in setting.old_names]

    assert not set(old_names) & set(catalogue())


def test_loading_needs_none_of_the_slow_libraries():
    slow = "{'torch', 'numpy', 'mujoco', 'boto3', 'typer', 'rich'}"
    code = f"import sys, drcli.config.settings; print({slow} & set(sys.modules) or '')"

    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)

    assert printed.stdout.strip() == b""


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ("DR_SIM_GROW=True\n", True),
        ("DR_SIM_GROW=True\nDR_SIM_LATENCY=0.05\n", True),
        ("DR_SIM_GROW=True\nDR_SIM_BLUR=1\nDR_SIM_EXTRAS_IN=evaluation\n", True),
        ("DR_SIM_GROW=True\nDR_SIM_BLUR=1\n", False),
        ("DR_SIM_BLUR=1\n", False),
        ("", False),
    ],
)
def test_growth_without_ranges_of_training_episodes_is_told(folder, lines, told):
    warnings = [each for each in folder.load(lines).warnings if "DR_SIM_GROW" in each]

    assert (
        warnings
        == [
            "run.env line 1: DR_SIM_GROW=True has no effect: training episodes draw "
            "from no range that could grow."
        ]
        * told
    )
