"""Settings that are refused, and in which words."""

import pwd

import pytest

from drcli.base.errors import ProblemsError, SettingsError
from drcli.config.loading import load_settings


@pytest.mark.parametrize(
    ("line", "sentence", "remedy"),
    [
        pytest.param(
            "DR_WORKERS=abc",
            "run.env line 2: DR_WORKERS=abc is not a whole number.",
            "Set DR_WORKERS to a whole number from 0 to 1000, or leave it out for the default 1.",
            id="not-a-whole-number",
        ),
        pytest.param(
            "DR_WORKERS=2.5",
            "run.env line 2: DR_WORKERS=2.5 is not a whole number.",
            "Set DR_WORKERS to a whole number from 0 to 1000, or leave it out for the default 1.",
            id="fraction-of-a-worker",
        ),
        pytest.param(
            "DR_WORKERS=1001",
            "run.env line 2: DR_WORKERS=1001 is above 1000.",
            "Set DR_WORKERS to a whole number from 0 to 1000, or leave it out for the default 1.",
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
            "run.env line 2: DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST=5 % is not a number.",
            "Set DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST to a number from 0 to 1, "
            "or leave it out for the default 0.05.",
            id="not-a-number",
        ),
        pytest.param(
            "DR_EVAL_COLLISION_PENALTY=nan",
            "run.env line 2: DR_EVAL_COLLISION_PENALTY=nan is not a number.",
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
            "run.env line 2: DR_RACE_TYPE=TIMETRIAL is not one of TIME_TRIAL, OBJECT_AVOIDANCE, "
            "HEAD_TO_BOT, HEAD_TO_MODEL.",
            "Did you mean TIME_TRIAL? Write one of these.",
            id="unknown-choice",
        ),
        pytest.param(
            "DR_WORKER=2",
            "run.env line 2: DR_WORKER=2 is not a setting.",
            "Did you mean DR_WORKERS? Correct the name, or remove the line.",
            id="misspelt-name",
        ),
        pytest.param(
            "dr_world_name=Oval_track",
            "run.env line 2: dr_world_name=Oval_track is not a setting.",
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
            "DR_LOCAL_S3_MODEL_PREFIX=../model",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=../model has . or .. between its slashes.",
            "Write folders as in team/model-1.",
            id="prefix-above-the-bucket",
        ),
        pytest.param(
            "DR_LOCAL_S3_MODEL_PREFIX=/",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=/ is empty.",
            "Write a name such as rl-deepracer-1.",
            id="prefix-of-slashes",
        ),
        pytest.param(
            "DR_RACE_TYPE=HEAD_TO_HEAD",
            "run.env line 2: DR_RACE_TYPE=HEAD_TO_HEAD is not one of TIME_TRIAL, OBJECT_AVOIDANCE, "
            "HEAD_TO_BOT, HEAD_TO_MODEL.",
            "Write HEAD_TO_BOT to train against bots, or HEAD_TO_MODEL to evaluate against another "
            "model.",
            id="head-to-head",
        ),
        pytest.param(
            "DR_LOCAL_S3_MODEL_PREFIX=my model",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=my model contains ' ', which is not allowed "
            "in a name in the bucket.",
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
            "DR_LOCAL_S3_MODEL_PREFIX=runs/fast",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=runs/fast is inside runs/, where "
            "trainings and races keep files of their own.",
            "Choose a prefix that starts with another name, such as my-runs/.",
            id="prefix-among-running-trainings",
        ),
        pytest.param(
            "DR_LOCAL_S3_CUSTOM_FILES_PREFIX=rl-deepracer-sagemaker/mine",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=rl-deepracer-sagemaker is the folder of your "
            "own files, or contains it "
            "(DR_LOCAL_S3_CUSTOM_FILES_PREFIX=rl-deepracer-sagemaker/mine).",
            "Give the model a separate folder; otherwise -w would delete your files.",
            id="own-files-in-the-model",
        ),
        pytest.param(
            "DR_LOCAL_S3_MODEL_PREFIX=custom_files/model",
            "run.env line 2: DR_LOCAL_S3_MODEL_PREFIX=custom_files/model is inside the folder of "
            "your own files (DR_LOCAL_S3_CUSTOM_FILES_PREFIX=custom_files).",
            "Give the model a folder outside it; otherwise they could overwrite each other.",
            id="model-among-own-files",
        ),
        pytest.param(
            "DR_LOCAL_S3_BUCKET=s3://bucket",
            "run.env line 2: DR_LOCAL_S3_BUCKET=s3://bucket is not the name of a bucket.",
            "Write its plain name of 3 to 63 letters, digits, dots and hyphens, without s3://.",
            id="bucket-as-address",
        ),
        pytest.param(
            "DR_LOCAL_S3_BUCKET=Bad_Bucket",
            "run.env line 2: DR_LOCAL_S3_BUCKET=Bad_Bucket is not the name of a bucket with "
            "DR_CLOUD=local.",
            "Write 3 to 63 lowercase letters, digits, dots and hyphens, with a letter or digit "
            "first and last, as in my-bucket.",
            id="bucket-that-s3-refuses",
        ),
        pytest.param(
            "DR_AWS_APP_REGION=eu_west",
            "run.env line 2: DR_AWS_APP_REGION=eu_west is not an AWS region.",
            "Write one such as us-east-1 or eu-central-1.",
            id="region",
        ),
        pytest.param(
            f"DR_LOCAL_S3_MODEL_PREFIX={'m' * 256}",
            f"run.env line 2: DR_LOCAL_S3_MODEL_PREFIX={'m' * 80}... is too long for servers and "
            "disks.",
            "Write at most 255 characters between slashes, and 800 in all.",
            id="long-prefix",
        ),
        pytest.param(
            "DR_OA_OBJECT_POSITIONS=0.5,inf\nDR_RACE_TYPE=OBJECT_AVOIDANCE",
            "run.env line 2: DR_OA_OBJECT_POSITIONS=0.5,inf is not a list of progress,lane pairs.",
            'Write progress 0 to 1 and lane 1 or -1, as in "0.23,-1;0.46,1".',
            id="infinite-lane",
        ),
        pytest.param(
            "DR_SAGEMAKER_CUDA_DEVICES=0;1",
            "run.env line 2: DR_SAGEMAKER_CUDA_DEVICES=0;1 is not a list of GPUs.",
            "Write numbers as nvidia-smi counts them, such as 0 or 0,1, or -1 for none.",
            id="gpus",
        ),
        pytest.param(
            "DR_REMOTE_MINIO_URL=http://host:9000/x?y=1",
            "run.env line 2: DR_REMOTE_MINIO_URL=http://host:9000/x?(hidden) has a query, which "
            "the address of an S3 server cannot have.",
            "Leave out everything from ? on.",
            id="address-with-a-query",
        ),
        pytest.param(
            "DR_UPLOAD_S3_ENDPOINT_URL=http://host:9000/#top",
            "run.env line 2: DR_UPLOAD_S3_ENDPOINT_URL=http://host:9000/#top has a fragment, which "
            "the address of an S3 server cannot have.",
            "Leave out everything from # on.",
            id="address-with-a-fragment",
        ),
        pytest.param(
            "DR_REMOTE_MINIO_URL=mynas:9000",
            "run.env line 2: DR_REMOTE_MINIO_URL=mynas:9000 is not a web address.",
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
            "DR_H2B_UPPER_LANE_CHANGE_TIME=2.0\nDR_RACE_TYPE=HEAD_TO_BOT",
            "run.env line 2: DR_H2B_LOWER_LANE_CHANGE_TIME=3.0 is more than "
            "DR_H2B_UPPER_LANE_CHANGE_TIME=2.0.",
            "Swap the two, or set both to the same time.",
            id="lane-change-times-crossed",
        ),
        pytest.param(
            "DR_CAR_NAME=$TEAM",
            "run.env line 2: DR_CAR_NAME=$TEAM refers to TEAM, which is not set.",
            "Set TEAM in system.env or in the environment, or write the value itself. "
            "In single quotes, a dollar sign stays as it is.",
            id="reference-to-nothing",
        ),
        pytest.param(
            "DR_CAR_NAME=$A\nA=$DR_CAR_NAME",
            "run.env line 3: A=$DR_CAR_NAME refers to itself or through too many names "
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
            "run.env line 2: DR_EXPERIMENT_NAME=first is set in the run.env that it should choose.",
            "Move the line to system.env.",
            id="experiment-in-run-env",
        ),
        pytest.param(
            'DR_CAR_NAME="a\\nb"',
            "run.env line 2: DR_CAR_NAME='a\\nb' contains a line break or control character.",
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

    refusal = folder.refusal("DR_WORKERS=-1\nDR_WORLDNAME=x\nDR_EVAL_MAX_RESETS=-1\n")

    assert str(refusal).splitlines() == [
        "run.env line 1: DR_WORKERS=-1 is below 0.",
        "run.env line 2: DR_WORLDNAME=x is not a setting.",
        "run.env line 3: DR_EVAL_MAX_RESETS=-1 is below 0.",
        "system.env line 1: DR_CLOUD=lokal is not one of local, remote, aws, azure.",
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
    assert str(refusal) == f"run.env line {line}: A=$B refers to B, which is not set."


def test_settings_that_refer_to_each_other_in_a_circle_are_refused(folder):
    refusal = folder.refusal("DR_CAR_NAME=$DR_RACER_NAME\nDR_RACER_NAME=$DR_CAR_NAME\n")

    assert "refers to itself" in str(refusal)


def test_names_that_multiply_each_other_cannot_fill_the_memory(folder):
    lines = [f"A{k}=$A{k + 1}$A{k + 1}$A{k + 1}$A{k + 1}" for k in range(15)]

    refusal = folder.refusal("\n".join([*lines, "A15=xxxx", "DR_CAR_NAME=$A0"]))

    assert "is longer than 4096 characters once filled in" in str(refusal)


def test_a_filled_in_value_is_shown_with_what_was_written(folder):
    refusal = folder.refusal("N=many\nDR_WORKERS=$N")

    assert str(refusal) == "run.env line 2: DR_WORKERS=many is not a whole number (written $N)."


@pytest.mark.parametrize("layer", ["environ", "flags"])
def test_a_mistake_outside_the_files_names_its_place(folder, layer):
    refusal = folder.refusal("", **{layer: {"DR_WORKERS": "all"}})

    place = {"environ": "environment", "flags": "flag"}[layer]
    assert str(refusal) == f"{place}: DR_WORKERS=all is not a whole number."


@pytest.mark.parametrize("target", ["system.env", "nowhere"])
def test_a_link_that_leads_nowhere_is_no_missing_file(folder, target):
    (folder.path / "system.env").unlink()
    (folder.path / "system.env").symlink_to(target)

    refusal = folder.refusal("DR_WORKERS=2\n")

    assert str(refusal).startswith("system.env: cannot be read (")


def test_a_folder_without_run_env_is_refused(tmp_path):
    with pytest.raises(SettingsError) as refusal:
        load_settings(tmp_path, environ={})

    assert str(refusal.value) == f"run.env: there is no such file in {tmp_path}."
    assert "dr init" in refusal.value.remedy


def test_a_file_that_is_no_text_is_all_that_is_reported(folder):
    folder.write("system.env", b"TEAM=blue\nDR_CLOUD=\xff\n")

    refusal = folder.refusal("DR_CAR_NAME=$TEAM\n")

    assert str(refusal) == "system.env line 2: Byte 0xff is not UTF-8 text."


def test_a_password_in_a_wrong_address_is_not_repeated(folder):
    refusal = folder.refusal("DR_REMOTE_MINIO_URL=ftp://me:secret@nas:9000\n")

    assert "secret" not in str(refusal)
    assert "DR_REMOTE_MINIO_URL=ftp://(hidden)@nas:9000" in str(refusal)


def test_findings_and_warnings_of_a_refused_load_can_be_told_apart(folder):
    refusal = folder.refusal("DR_WORKERS=-1\nTEAM=blue\n")

    assert isinstance(refusal, ProblemsError)
    assert [(problem.where, problem.severity) for problem in refusal.problems] == [
        ("run.env line 1", "error"),
        ("run.env line 2", "warning"),
    ]
    assert str(refusal.problems[1]) == ("run.env line 2: TEAM is not a setting and has no effect.")


def test_of_very_many_findings_only_some_are_listed(folder):
    refusal = folder.refusal("no equal sign\n" * 1_000)

    lines = str(refusal).splitlines()
    assert len(lines) == 41
    assert lines[-1] == "And 960 more like these."
    assert len(refusal.problems) == 1_000


def test_of_very_many_warnings_only_some_are_listed(folder):
    settings = folder.load("".join(f"A{k}=1\n" for k in range(100)))

    assert settings.warnings[-1] == "And 60 more like these."


def test_a_path_in_the_home_of_a_user_who_has_none_is_refused(folder, monkeypatch):
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(pwd, "getpwuid", _no_user)
    folder.write("system.env", "DR_S3_DATA_DIR=~/bucket\n")

    refusal = folder.refusal("")

    assert "system.env line 1: DR_S3_DATA_DIR=~/bucket begins with ~" in str(refusal)
    assert "Write the whole path, or set HOME." in refusal.remedy


def _no_user(number):
    raise KeyError(number)


def test_an_unknown_track_is_told_with_the_other_errors_and_not_alone(folder):
    refusal = folder.refusal("DR_WORLD_NAME=nowhere\nDR_WORKERS=-1\n")

    assert str(refusal).splitlines() == [
        "run.env line 1: DR_WORLD_NAME=nowhere is not a known track.",
        "run.env line 2: DR_WORKERS=-1 is below 0.",
    ]
    assert folder.load("DR_WORLD_NAME=nowhere\n").world_name == "nowhere"
