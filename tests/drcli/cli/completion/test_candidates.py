"""What the Tab key is answered."""

import subprocess
import sys

import pytest

from drcli.cli.completion import values
from drcli.cli.completion.answer import candidates, main
from drcli.cli.completion.places import VALUES
from drcli.cli.completion.values import Place
from drcli.cli.lazy import load
from drcli.cli.table import COMMANDS, program_names
from drcli.config.settings import catalogue

SLOW = {"torch", "mujoco", "boto3", "botocore", "numpy", "numba", "rich", "pydantic", "drsim"}


def words(program: str, *typed: str) -> list[str]:
    """Candidates for the last of the words behind a program."""
    return [word for word, _ in candidates(program, list(typed[:-1]), typed[-1])]


@pytest.fixture
def trained(working_folder):
    """A folder with two models in its bucket."""
    for prefix in ("model", "team/other", "team/deep/er"):
        folder = working_folder / "data" / "s3" / "bucket" / prefix / "model"
        folder.mkdir(parents=True)
        for number in (0, 2, 10):
            (folder / f"{number}_Step-{number * 90}.ckpt.safetensors").touch()
    return working_folder


def test_commands_come_with_what_they_do(working_folder):
    [(word, meaning)] = candidates("dr", [], "stat")

    assert word == "status"
    assert meaning.startswith("How the training goes")


def test_no_command_of_our_own_scripts_is_shown(working_folder):
    assert "shell-env" not in words("dr", "")


@pytest.mark.parametrize("typed", [("dr", "status"), ("dr-status",), ("/opt/bin/dr-status",)])
def test_options_of_a_command_are_known_under_each_of_its_names(working_folder, typed):
    program = typed[0].rpartition("/")[2]

    assert "--json" in words(program, *typed[1:], "--")


def test_an_option_that_is_there_is_not_offered_again(working_folder):
    offered = words("dr-start-training", "-wq", "--seed", "3", "--")

    assert "--resume" in offered
    assert not {"--wipe", "--quiet", "--seed"} & set(offered)


def test_a_group_offers_its_commands_and_then_theirs(working_folder):
    assert words("dr-tracks", "") == ["list", "show", "add", "fetch"]
    assert words("dr", "tracks", "sh") == ["show"]
    assert "--png" in words("dr-tracks", "show", "bean", "--p")


def test_worlds_are_those_built_in_and_the_racers_own(working_folder):
    (working_folder / "tracks").mkdir()
    (working_folder / "tracks" / "backyard.npy").touch()

    offered = words("dr-tracks", "show", "")

    assert {"reinvent_base", "backyard"} <= set(offered)
    assert words("dr-init", "--world", "backy") == ["backyard"]


def test_models_are_found_in_the_folder_of_the_bucket(trained):
    assert words("dr-increment-training", "-p", "") == ["model", "team/deep/er", "team/other"]
    assert words("dr-increment-training", "--prefix", "team/o") == ["team/other"]


def test_no_server_is_asked_for_models_elsewhere(trained):
    (trained / "system.env").write_text("DR_CLOUD=remote\nDR_REMOTE_MINIO_URL=http://127.0.0.1:9\n")

    assert words("dr-increment-training", "-p", "") == ["model"]


def test_checkpoints_are_numbers_the_newest_first(trained):
    assert words("dr-upload-model", "-c", "") == ["10", "2", "0"]


def test_settings_are_offered_by_name_and_known_ones_with_values(working_folder):
    assert words("dr-config", "set", "DR_WOR") == ["DR_WORKERS=", "DR_WORLD_NAME="]
    assert words("dr-config", "set", "DR_RACE_TYPE=H") == [
        "DR_RACE_TYPE=HEAD_TO_BOT",
        "DR_RACE_TYPE=HEAD_TO_MODEL",
    ]
    assert words("dr-config", "show", "DR_CLOUD_") == [
        "DR_CLOUD_WATCH_ENABLE",
        "DR_CLOUD_WATCH_LOG_STREAM_PREFIX",
    ]


def test_experiments_and_workers_are_those_of_the_folder(working_folder):
    for name in ("fast", "slow"):
        (working_folder / "experiments" / name).mkdir(parents=True)
        (working_folder / "experiments" / name / "run.env").touch()

    assert words("dr-init", "--experiment", "") == ["fast", "slow"]
    assert words("dr-logs", "") == [
        "sim",
        "trainer",
        "supervisor",
        "evaluation",
        "sim-0",
        "sim-1",
    ]


def test_file_names_are_left_to_the_shell(working_folder):
    assert words("dr-tracks", "add", "") == []


@pytest.mark.parametrize("typed", [("nonsense", ""), ("tracks", "nonsense", ""), ("status", "x")])
def test_what_is_wrong_already_gets_no_candidates(working_folder, typed):
    assert words("dr", *typed) == []


@pytest.mark.parametrize("line", ["nonsense\n", "DR_WORKERS=many\n", "\0"])
def test_broken_settings_do_no_harm(working_folder, line):
    (working_folder / "run.env").write_text(line)

    assert "--follow" in words("dr-logs", "trainer", "--")
    assert "trainer" in words("dr-logs", "")
    assert words("dr-increment-training", "-p", "") == []


def test_bash_gets_only_the_part_behind_the_equals_sign(working_folder, monkeypatch, capsys):
    call = ["drcli-complete", "bash", "dr-config", "set", "DR_CLOUD", "=", "l"]
    monkeypatch.setattr("sys.argv", call)

    main()

    assert capsys.readouterr().out == "local\n"


def test_a_current_folder_that_is_gone_has_no_candidates(
    working_folder, tmp_path_factory, monkeypatch, capsys
):
    folder = tmp_path_factory.mktemp("gone")
    monkeypatch.chdir(folder)
    folder.rmdir()
    monkeypatch.setattr("sys.argv", ["drcli-complete", "zsh", "dr-logs", ""])

    main()

    assert capsys.readouterr().out == ""


def test_every_place_is_a_parameter_of_a_command():
    known = set()
    for command in COMMANDS:
        loaded = load(command)
        for name, single in getattr(loaded, "commands", {"": loaded}).items():
            path = f"{command.name} {name}".strip()
            known |= {(path, parameter.name) for parameter in single.params}

    assert set(VALUES) <= known


def test_names_known_by_heart_are_those_of_the_settings():
    assert sorted(values.setting_names(Place(None))) == sorted(catalogue())
    assert catalogue()["DR_RACE_TYPE"].choices == values.RACE_TYPES
    assert catalogue()["DR_CLOUD"].choices == values.CLOUDS


@pytest.mark.parametrize(
    "typed", [["dr", "s"], ["dr-tracks", "show", ""], ["dr-config", "set", "DR_"], ["dr-logs", ""]]
)
def test_an_answer_loads_nothing_slow(working_folder, typed):
    program = (
        f"import sys; sys.argv[1:] = ['zsh', *{typed!r}]\n"
        "from drcli.cli.completion.answer import main\n"
        f"main(); print({SLOW!r} & sys.modules.keys(), file=sys.stderr)"
    )

    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)

    assert done.stderr == "set()\n"
    assert done.stdout


def test_every_program_is_known():
    assert {"dr", "dr-status", "dr-start-training", "droa-import-model"} <= set(program_names())
