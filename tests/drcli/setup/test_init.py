"""`dr init`: a folder in which a training can start at once, and no file lost on the way."""

import json
import os
import re
import stat
from pathlib import Path

import pytest

from drcli.config import load_settings
from drcli.setup.shipped import model_file

WRITTEN = [
    "run.env",
    "system.env",
    "custom_files/reward_function.py",
    "custom_files/hyperparameters.json",
    "custom_files/model_metadata.json",
    "bin/activate.sh",
    ".gitignore",
]


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """A folder with nothing in it, current; its name is one that shells trip over."""
    folder = tmp_path / "Müllers Auto $1"
    folder.mkdir()
    for name in os.environ:
        if name.startswith("DR_"):
            monkeypatch.delenv(name)
    monkeypatch.chdir(folder)
    return folder


def settings_of(folder: Path):
    return load_settings(folder, environ={})


def test_everything_a_training_needs_is_written(dr, empty, capsys):
    code = dr("init", "--json")

    report = json.loads(capsys.readouterr().out)
    settings = settings_of(empty)
    assert code == 0
    assert report["written"] == WRITTEN
    assert report["folder"] == str(empty)
    assert settings.warnings == ()
    assert (empty / "tracks").is_dir()
    assert "/data/" in (empty / ".gitignore").read_text().splitlines()


def test_a_folder_that_is_not_there_is_made(dr, empty):
    code = dr("init", "new/racer")

    assert code == 0
    assert settings_of(empty / "new" / "racer").cloud == "local"


def test_options_end_up_in_their_files(dr, empty):
    dr(
        *("init", "--world", "bean", "--race-type", "OBJECT_AVOIDANCE", "--prefix", "team/m-1"),
        *("--workers", "3", "--cloud", "remote", "--endpoint", "http://nas:9000"),
        *("--bucket", "races", "--profile", "minio"),
    )

    s = settings_of(empty)
    assert (s.world_name, s.race_type, s.model_prefix) == ("bean", "OBJECT_AVOIDANCE", "team/m-1")
    assert (s.workers, s.cloud, s.remote_minio_url) == (3, "remote", "http://nas:9000")
    assert (s.bucket, s.profile) == ("races", "minio")
    assert s.source("DR_REMOTE_MINIO_URL").startswith("system.env line ")
    system = (empty / "system.env").read_text()
    assert len(re.findall(r"^(?:# )?DR_REMOTE_MINIO_URL=", system, re.MULTILINE)) == 1


def test_the_files_of_a_model_fit_its_race(dr, empty):
    dr("init", "--race-type", "HEAD_TO_BOT")

    wanted = model_file("rewards/head_to_bot/reward_function.py").read_bytes()
    assert (empty / "custom_files" / "reward_function.py").read_bytes() == wanted


@pytest.mark.parametrize(
    ("file", "literal", "name", "value"),
    [
        ("system.env", "DR_LOCAL_S3_BUCKET=bucket", "bucket", "theirs"),
        ("system.env", "DR_UPLOAD_S3_BUCKET=not-defined", "upload_s3_bucket", "theirs"),
        ("run.env", "DR_UPLOAD_S3_PREFIX=upload", "upload_s3_prefix", "upload/oval/m-1"),
        (
            "run.env",
            "DR_LOCAL_S3_CUSTOM_FILES_PREFIX=custom_files",
            "custom_files_prefix",
            "custom_files/oval/m-1",
        ),
    ],
)
def test_a_spot_instance_finds_the_lines_that_it_replaces(dr, empty, file, literal, name, value):
    dr("init")
    path = empty / file

    path.write_text(path.read_text().replace(literal, f"{literal.partition('=')[0]}={value}"))

    assert getattr(settings_of(empty), name) == value


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--cloud", "locla"], "DR_CLOUD=locla is none of local, remote, aws, azure"),
        (["--cloud", "remote"], "DR_REMOTE_MINIO_URL is empty"),
        (["--prefix", "a b"], "DR_LOCAL_S3_MODEL_PREFIX=a b holds ' '"),
        (["--race-type", "RALLY"], "DR_RACE_TYPE=RALLY is none of"),
    ],
)
def test_a_wrong_value_is_refused_before_anything_is_written(dr, empty, capsys, options, words):
    code = dr("init", *options)

    assert code == 3
    assert words in capsys.readouterr().err
    assert list(empty.iterdir()) == []


def test_a_world_that_is_not_here_is_named_with_the_way_to_get_it(dr, empty, capsys):
    code = dr("init", "--world", "Oval_track")

    said = capsys.readouterr().err
    assert code == 0
    assert "Warning: There is no track Oval_track here yet" in said
    assert "dr-tracks fetch Oval_track" in said


def test_files_that_are_there_are_listed_and_kept(dr, empty, capsys):
    (empty / "run.env").write_text("DR_WORLD_NAME=mine\n")
    (empty / "custom_files").mkdir()
    (empty / "custom_files" / "reward_function.py").write_text("mine")

    code = dr("init")

    said = capsys.readouterr().err
    assert code == 2
    assert "there are already: run.env, custom_files/reward_function.py." in said
    assert "--force" in said
    assert (empty / "run.env").read_text() == "DR_WORLD_NAME=mine\n"
    assert not (empty / "system.env").exists()


def test_force_replaces_them_and_keeps_a_copy_of_each_every_time(dr, empty, capsys):
    (empty / "run.env").write_text("first\n")
    dr("init", "--force", "--json")
    (empty / "run.env").write_text("second\n")
    capsys.readouterr()

    dr("init", "--yes", "--json")

    report = json.loads(capsys.readouterr().out)
    assert report["written"] == ["run.env"]
    assert report["backups"] == ["run.env.bak1"]
    assert (empty / "run.env.bak").read_text() == "first\n"
    assert (empty / "run.env.bak1").read_text() == "second\n"
    assert settings_of(empty).world_name == "reinvent_base"


def test_doing_it_twice_changes_nothing(dr, empty, capsys):
    dr("init")
    capsys.readouterr()

    code = dr("init", "--json")

    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert report["written"] == report["backups"] == []
    assert report["unchanged"] == WRITTEN


def test_the_racers_own_lines_for_git_stay(dr, empty):
    (empty / ".gitignore").write_text("*.pyc")

    dr("init")

    assert (empty / ".gitignore").read_text() == "*.pyc\n/data/\n"


def test_files_have_the_mode_that_the_umask_says(dr, empty):
    before = os.umask(0o027)
    try:
        dr("init")
    finally:
        os.umask(before)

    modes = {stat.S_IMODE((empty / name).stat().st_mode) for name in WRITTEN}
    assert modes == {0o640}
    assert stat.S_IMODE((empty / "custom_files").stat().st_mode) == 0o750


def test_options_of_the_reference_are_taken(dr, empty, capsys):
    code = dr("init", "-c", "local", "-a", "gpu", "-s", "swarm")

    assert code == 0
    assert "no" in capsys.readouterr().err


def test_an_experiment_begins_with_what_the_folder_has_and_can_run_beside_it(dr, empty, capsys):
    dr("init", "--world", "bean")
    (empty / "custom_files" / "reward_function.py").write_text("# mine\n")

    code = dr("init", "--experiment", "fast")

    own = load_settings(empty, environ={}, experiment="fast")
    main = settings_of(empty)
    assert code == 0
    assert own.world_name == "bean"
    assert (main.run_id, own.run_id) == (0, 1)
    assert own.model_prefix == "fast"
    assert own.custom_files_prefix == "custom_files/fast"
    assert (own.custom_files_dir / "reward_function.py").read_text() == "# mine\n"
    assert "source bin/activate.sh -e fast" in capsys.readouterr().err


def test_the_next_experiment_gets_the_next_number(dr, empty):
    dr("init")
    dr("init", "--experiment", "one")

    dr("init", "--experiment", "two", "--prefix", "my-model", "--world", "bean")

    two = load_settings(empty, environ={}, experiment="two")
    assert (two.run_id, two.model_prefix, two.world_name) == (2, "my-model", "bean")


@pytest.mark.parametrize(("name", "options"), [("a/b", []), ("..", []), ("x", ["--cloud", "aws"])])
def test_an_experiment_that_cannot_be_is_refused(dr, empty, name, options):
    dr("init")

    code = dr("init", "--experiment", name, *options)

    assert code == 3
    assert not (empty / "experiments").exists()


def test_an_experiment_needs_a_working_folder(dr, empty, capsys):
    code = dr("init", "--experiment", "fast")

    assert code == 3
    assert "dr init" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_a_sentence(dr, empty, capsys):
    (empty / "file").write_text("")

    code = dr("init", "file/racer")

    assert code == 3
    assert "cannot be made" in capsys.readouterr().err
