"""What the Tab key is answered."""

import os
import subprocess
import sys
from contextlib import suppress

import pytest

from drcli.cli import program
from drcli.cli.app import main
from drcli.cli.completion import ASKS, LINE

SLOW = {"torch", "mujoco", "boto3", "botocore", "numpy", "numba", "drsim"}


@pytest.fixture
def answers(working_folder, monkeypatch, capsys):
    """Asks as a shell does; returns candidates and their meanings."""

    def ask(line):
        for name, value in {**ASKS, LINE: line}.items():
            monkeypatch.setenv(name, value)
        with pytest.raises(SystemExit):
            main()
        lines = capsys.readouterr().out.splitlines()
        return dict(line.partition("\t")[::2] for line in lines if line)

    return ask


@pytest.fixture
def words(answers):
    """Candidates for the last word of a line."""
    return lambda line: list(answers(line))


@pytest.fixture
def trained(working_folder, words):
    """A folder with two models in its bucket."""
    for prefix in ("model", "team/other", "team/deep/er"):
        folder = working_folder / "data" / "s3" / "bucket" / prefix / "model"
        folder.mkdir(parents=True)
        for number in (0, 2, 10):
            (folder / f"{number}_Step-{number * 90}.ckpt.safetensors").touch()
    return working_folder


def test_commands_come_with_what_they_do(working_folder, answers):
    assert answers("dr stat") == {"status": "Show state, curves and checkpoints."}


def test_no_command_of_our_own_scripts_is_shown(working_folder, words):
    assert "shell-env" not in words("dr ")


@pytest.mark.parametrize("typed", ["dr status", "dr-status", "/opt/bin/dr-status"])
def test_options_of_a_command_are_known_under_each_of_its_names(working_folder, words, typed):
    assert "--json" in words(f"{typed} --")


def test_an_option_that_is_there_is_not_offered_again(working_folder, words):
    offered = words("dr-start-training -wq --seed 3 --")

    assert "--resume" in offered
    assert not {"--wipe", "--quiet", "--seed"} & set(offered)


def test_a_group_offers_its_commands_and_then_theirs(working_folder, words):
    assert words("dr-tracks ") == ["list", "show", "line", "limit", "add", "generate", "fetch"]
    assert words("dr tracks sh") == ["show"]
    assert "--png" in words("dr-tracks show bean --p")


def test_worlds_are_those_built_in_and_the_racers_own(working_folder, words):
    (working_folder / "tracks").mkdir()
    (working_folder / "tracks" / "backyard.npy").touch()

    offered = words("dr-tracks show ")

    assert {"reinvent_base", "backyard"} <= set(offered)
    assert words("dr-init --world backy") == ["backyard"]


def test_models_are_found_in_the_folder_of_the_bucket(trained, words):
    assert words("dr-increment-training -p ") == ["model", "team/deep/er", "team/other"]
    assert words("dr-increment-training --prefix team/o") == ["team/other"]


def test_no_server_is_asked_for_models_elsewhere(trained, words):
    (trained / "system.env").write_text("DR_CLOUD=remote\nDR_REMOTE_MINIO_URL=http://127.0.0.1:9\n")

    assert words("dr-increment-training -p ") == ["model"]


def test_checkpoints_are_numbers_the_newest_first(trained, words):
    assert words("dr-upload-model -c ")[:4] == ["10", "2", "0", "last"]
    assert words("dr-upload-model -c f") == ["first-lap"]


def test_settings_are_offered_by_name_and_known_ones_with_values(working_folder, words):
    assert words("dr-config set DR_WOR") == ["DR_WORKERS=", "DR_WORKER_DEVICE=", "DR_WORLD_NAME="]
    assert words("dr-config set DR_RACE_TYPE=H") == [
        "DR_RACE_TYPE=HEAD_TO_BOT",
        "DR_RACE_TYPE=HEAD_TO_MODEL",
    ]
    assert words("dr-config show DR_CLOUD_WATCH_LOG") == [
        "DR_CLOUD_WATCH_LOG_GROUP",
        "DR_CLOUD_WATCH_LOG_STREAM_PREFIX",
    ]


def test_experiments_and_workers_are_those_of_the_folder(working_folder, words):
    for name in ("fast", "slow"):
        (working_folder / "experiments" / name).mkdir(parents=True)
        (working_folder / "experiments" / name / "run.env").touch()

    assert words("dr-init --experiment ") == ["fast", "slow"]
    assert words("dr-logs ") == [
        "sim",
        "trainer",
        "supervisor",
        "evaluation",
        "reward",
        "sim-0",
        "sim-1",
    ]


def test_file_names_are_left_to_the_shell(working_folder, words):
    assert words("dr-tracks add ") == []


def test_what_is_wrong_already_gets_no_candidates(working_folder, words):
    assert words("dr tracks nonsense x") == []
    assert words("dr status x") == []


@pytest.mark.parametrize("line", ["nonsense\n", "DR_WORKERS=many\n", "\0"])
def test_broken_settings_do_no_harm(working_folder, words, line):
    (working_folder / "run.env").write_text(line)

    assert "--follow" in words("dr-logs trainer --")
    assert "trainer" in words("dr-logs ")
    assert words("dr-increment-training -p ") == []


@pytest.mark.parametrize("line", ["dr-status --js", "dr-config set 'DR_CLOUD=re"])
def test_quotes_that_are_still_open_do_no_harm(working_folder, words, line):
    assert words(line) == [{"dr-status": "--json"}.get(line.split()[0], "DR_CLOUD=remote")]


def test_a_current_folder_that_is_gone_does_no_harm(words, tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("gone")
    monkeypatch.chdir(folder)
    folder.rmdir()

    assert "trainer" in words("dr-logs ")


@pytest.mark.parametrize(
    ("line", "words"), [("zsh dr-status --js", ["--json"]), ("bash dr-config set DR_CLOUD = l", [])]
)
def test_shells_that_the_first_version_has_set_up_get_answers(
    working_folder, monkeypatch, capsys, line, words
):
    for name in (*ASKS, LINE):
        monkeypatch.setenv(name, "")  # so that it is taken away again
        monkeypatch.delenv(name)
    monkeypatch.setattr("sys.argv", ["drcli-complete", *line.split()])

    with suppress(SystemExit):
        program.answer_former_shells()

    printed = capsys.readouterr()
    assert [answer.partition("\t")[0] for answer in printed.out.splitlines()] == words
    assert printed.err == ""


@pytest.mark.parametrize("line", ["dr s", "dr-tracks show ", "dr-config set DR_", "dr-logs "])
def test_an_answer_loads_nothing_slow(working_folder, line):
    program = (
        "import sys; from drcli.cli.app import main\n"
        f"try: main()\nfinally: print({SLOW!r} & sys.modules.keys(), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **ASKS, LINE: line},
        capture_output=True,
        text=True,
    )

    assert done.stderr == "set()\n"
    assert done.stdout
