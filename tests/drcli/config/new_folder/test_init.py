"""`dr init`: a folder in which a training can start at once, and no file lost on the way."""

import json
import os
import re
import shlex
import stat
from pathlib import Path

import pytest

from drcli.base import files
from drcli.base.errors import SettingsError
from drcli.checks.stage_rules import review_stages
from drcli.config import new_folder
from drcli.config.loading import load_settings
from drcli.config.presets import model_file

WRITTEN = [
    "run.env",
    "system.env",
    "custom_files/reward_function.py",
    "custom_files/hyperparameters.json",
    "custom_files/model_metadata.json",
    "bin/activate.sh",
    ".gitignore",
]


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


def test_a_folder_that_is_complete_is_kept(dr, empty, capsys):
    dr("init")
    first = capsys.readouterr().err

    dr("init")

    assert f"7 files written to {empty}.\n" in first
    assert f"0 files written to {empty}; 7 files kept.\n" in capsys.readouterr().err


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
        (["--cloud", "locla"], "--cloud locla is not one of local, remote, aws, azure. Did"),
        (["--cloud", "remote"], "--cloud remote needs an address, but --endpoint is empty. Set"),
        (["--prefix", "a b"], "--prefix a b contains ' '"),
        (["--prefix", "custom_files"], "--prefix custom_files is the folder of your own files"),
        (["--prefix", "a\nDR_WORKERS=9"], "--prefix 'a\\nDR_WORKERS=9' contains '\\n'"),
        (["--profile", "\udcff"], "--profile '\\udcff' cannot be written into"),
        (["--race-type", "RALLY"], "--race-type RALLY is not one of"),
        (
            ["--workers", "1001"],
            "--workers 1001 is above 1000. Set --workers to a whole number from 0",
        ),
        (["--workers", "-1"], "--workers -1 is below 0."),
        (
            ["--bucket", "Bad_Bucket"],
            "--bucket Bad_Bucket is not the name of a bucket with --cloud local",
        ),
        ([""], "The name of the folder is empty"),
        (["--experiment", ""], "--experiment  is not a plain folder name"),
    ],
    ids=str,
)
def test_a_bad_option_is_named_before_anything_is_written(dr, empty, capsys, options, words):
    code = dr("init", *options)

    assert code == 2
    assert words in capsys.readouterr().err
    assert list(empty.iterdir()) == []


def test_all_bad_options_are_named_at_once(dr, empty, capsys):
    dr("init", "--workers", "1001", "--cloud", "locla")

    said = capsys.readouterr().err
    assert "--workers 1001" in said
    assert "--cloud locla" in said


@pytest.mark.parametrize("value", ["my profile", "a # b", "#1"])
def test_a_value_gets_the_quotes_that_it_needs(dr, empty, value):
    code = dr("init", "--profile", value)

    assert code == 0
    assert settings_of(empty).profile == value


@pytest.mark.parametrize("obstacle", ["custom_files", "bin", "tracks"])
def test_a_file_where_a_folder_has_to_be_is_named_and_nothing_written(dr, empty, capsys, obstacle):
    (empty / obstacle).write_text("mine")

    code = dr("init")

    assert code == 3
    assert f"{empty / obstacle}: is not a folder" in capsys.readouterr().err
    assert [path.name for path in empty.iterdir()] == [obstacle]
    assert (empty / obstacle).read_text() == "mine"


def test_a_folder_of_tracks_that_nobody_may_write_to_is_no_obstacle(dr, empty, monkeypatch):
    (empty / "tracks").mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "tracks")

    assert dr("init") == 0


def test_a_folder_that_nobody_may_write_to_is_named(dr, empty, capsys, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != empty)

    code = dr("init", "new")

    assert code == 3
    assert f"{empty}: is write-protected." in capsys.readouterr().err
    assert list(empty.iterdir()) == []


@pytest.mark.parametrize("obstacle", ["run.env", "bin/activate.sh", ".gitignore"])
def test_a_folder_where_a_file_has_to_be_is_named_and_nothing_written(dr, empty, capsys, obstacle):
    (empty / obstacle).mkdir(parents=True)

    code = dr("init", "--force")

    assert code == 3
    assert f"{empty / obstacle}: is not a file" in capsys.readouterr().err
    assert [path for path in empty.rglob("*") if path.is_file()] == []


def test_what_fails_half_way_is_taken_back(dr, empty, capsys, monkeypatch):
    (empty / "run.env").write_text("mine\n")

    def rewrite_until_full(path: Path, data: bytes) -> None:
        if path.name == "model_metadata.json":
            raise SettingsError(f"{path}: no space left.", remedy="Make room.")
        files.rewrite(path, data)

    monkeypatch.setattr(new_folder, "rewrite", rewrite_until_full)
    code = dr("init", "--force")

    assert code == 3
    assert "no space left" in capsys.readouterr().err
    assert [path.name for path in empty.rglob("*")] == ["run.env"]
    assert (empty / "run.env").read_text() == "mine\n"


def test_a_world_that_is_not_here_is_named_with_the_way_to_get_it(dr, empty, capsys):
    code = dr("init", "--world", "Oval_track")

    said = capsys.readouterr().err
    assert code == 0
    assert "Warning: DR_WORLD_NAME=Oval_track is a community track that is not installed" in said
    assert said.index("fetch the track:") < said.index("dr-validate")


def test_a_world_that_nobody_knows_is_not_fetched(dr, empty, capsys):
    dr("init", "--world", "reinvent_bas")

    said = capsys.readouterr().err
    assert "DR_WORLD_NAME=reinvent_bas is not a known track. Did you mean reinvent_base?" in said
    assert "dr-tracks fetch reinvent_bas" not in said


def test_files_that_are_there_are_listed_and_kept(dr, empty, capsys):
    (empty / "run.env").write_text("DR_WORLD_NAME=mine\n")
    (empty / "custom_files").mkdir()
    (empty / "custom_files" / "reward_function.py").write_text("mine")

    code = dr("init")

    said = capsys.readouterr().err
    assert code == 2
    assert "already has run.env, custom_files/reward_function.py." in said
    assert "--force" in said
    assert (empty / "run.env").read_text() == "DR_WORLD_NAME=mine\n"
    assert not (empty / "system.env").exists()


def test_quiet_names_the_files_that_are_there_and_those_that_are_kept(dr, empty, capsys):
    (empty / "run.env").write_text("mine\n")

    dr("init", "-q")
    refused = capsys.readouterr().err
    dr("init", "-q", "--force")
    one = capsys.readouterr().err
    for name in ("run.env", "system.env"):
        (empty / name).write_text("mine again\n")
    dr("init", "-q", "--force")
    two = capsys.readouterr().err

    assert "already has run.env." in refused
    assert "The old file is kept as run.env.bak." in one
    assert "The old files are kept as run.env.bak1, system.env.bak." in two


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


def test_files_have_the_mode_that_the_umask_says_and_settings_are_private(dr, empty):
    empty.chmod(0o755)
    before = os.umask(0o027)
    try:
        dr("init")
    finally:
        os.umask(before)

    modes = {name: stat.S_IMODE((empty / name).stat().st_mode) for name in WRITTEN}
    assert {modes.pop(name) for name in ("run.env", "system.env")} == {0o600}
    assert set(modes.values()) == {0o640}
    assert stat.S_IMODE((empty / "custom_files").stat().st_mode) == 0o750


def test_options_of_the_reference_are_taken(dr, empty, capsys):
    code = dr("init", "-c", "local", "-a", "gpu", "-s", "swarm")

    assert code == 0
    assert "no" in capsys.readouterr().err


def test_a_shell_that_belongs_to_another_folder_is_told_how_to_leave_it(
    dr, empty, capsys, monkeypatch
):
    dr("init", "first")
    monkeypatch.setenv("DR_DIR", str(empty / "first"))
    capsys.readouterr()

    dr("init", "second")

    said = capsys.readouterr().err
    assert f"cd {shlex.quote(str(empty / 'second'))}" in said
    assert "unset DR_EXPERIMENT_NAME; source bin/activate.sh" in said


def test_a_folder_that_cannot_be_made_is_a_sentence(dr, empty, capsys):
    (empty / "file").write_text("")

    code = dr("init", "file/racer")

    assert code == 3
    assert f"{empty / 'file'}: is not a folder" in capsys.readouterr().err


def test_a_track_that_has_no_file_of_its_own_is_no_surprise(dr, empty, capsys):
    dr("init", "--world", "reinvent_carpet")

    assert "Warning" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "written", "said"),
    [
        ("Shanghai", "China_track", "Shanghai is the track China_track.\n"),
        ("Shanghia", "Shanghia", "is not a known track. Did you mean China_track?"),
    ],
)
def test_a_track_may_be_called_as_consoles_call_it(dr, empty, capsys, typed, written, said):
    assert dr("init", "--world", typed) == 0

    assert said in capsys.readouterr().err
    assert f"DR_WORLD_NAME={written}\n" in (empty / "run.env").read_text()


@pytest.mark.parametrize("experiment", [None, "fast"])
def test_a_folder_can_come_with_a_training_in_stages(empty, dr, experiment):
    more = ["--experiment", experiment] if experiment else []
    if experiment:
        assert dr("init", ".", "--force") == 0
    assert dr("init", ".", *more, "--curriculum", "--force") == 0

    folder = empty / "experiments" / experiment if experiment else empty
    example = model_file("curriculum.yaml").read_bytes()
    assert (folder / "curriculum.yaml").read_bytes() == example
    overtake = model_file("rewards/head_to_bot/reward_function.py").read_bytes()
    assert (folder / "overtake.py").read_bytes() == overtake
    flags = {"DR_EXPERIMENT_NAME": experiment or ""}
    settings = load_settings(empty, environ={}, flags=flags)
    staged = review_stages(settings, {})
    assert staged.problems == ()
    assert [stage.name for stage in staged.stages] == ["wide", "base", "hard", "bots"]


def test_an_example_replaces_only_the_three_files_of_a_folder_that_exists(dr, empty):
    assert dr("init", "--world", "bean") == 0
    before = Path("run.env").read_bytes()

    code = dr("init", "--example", "milestones", "-f")

    assert code == 0
    assert "milestone" in Path("custom_files/reward_function.py").read_text("utf-8")
    assert Path("run.env").read_bytes() == before
    assert Path("custom_files/reward_function.py.bak").is_file()


def test_a_new_folder_gets_the_files_of_an_example(dr, empty):
    assert dr("init", "mine", "--example", "straights") == 0
    assert "straight" in Path("mine/custom_files/reward_function.py").read_text("utf-8")


def test_an_unknown_example_is_refused_with_the_names(dr, empty, capsys):
    assert dr("init", "--example", "sped") == 3
    assert "Did you mean speed? Write one of speed," in capsys.readouterr().err


@pytest.mark.parametrize("preset", ["virtual", "student-league"])
def test_it_is_said_before_a_training_where_the_model_can_go(dr, empty, capsys, preset):
    assert dr("init", "--preset", preset, "--world", "bean") == 0

    said = capsys.readouterr().err
    assert "can go to the physical car, but not to DeepRacer on AWS" in said
    assert '"neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"' in said
    assert "`dr-export droa --distill`" in said
