"""A folder of DeepRacer-for-Cloud: its functions are found, replaced, and can be had back."""

import io
import subprocess
from pathlib import Path

import pytest

from drcli.config.adoption import winning_functions

THEIRS = """\
SCRIPT_DIR="$(cd "$(dirname "${BASH_SOURCE[0]:-}")" && pwd)"
export DR_DIR="$(dirname $SCRIPT_DIR)" DR_CONFIG="$(dirname $SCRIPT_DIR)/run.env"
export DR_TRAIN_COMPOSE_FILE="-c training.yml" DR_WORLD_NAME=bean DR_MINE=kept
alias dr-local-aws='aws'
source $SCRIPT_DIR/scripts_wrapper.sh
function dr-update {
  echo theirs
}
"""
WRAPPER = "function dr-start-training {\n  echo theirs\n}\nfunction droa-get-model {\n  echo x\n}\n"


def reference(folder: Path) -> Path:
    (folder / "bin").mkdir(parents=True)
    (folder / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")
    (folder / "system.env").write_text("DR_CLOUD=local\n")
    (folder / "bin" / "activate.sh").write_text(THEIRS)
    (folder / "bin" / "scripts_wrapper.sh").write_text(WRAPPER)
    return folder


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def theirs(home, monkeypatch):
    folder = reference(home / "drfc")
    monkeypatch.chdir(folder)
    return folder


def told(folder: Path, home: Path, **environ: str) -> list[str]:
    return [each.where for each in winning_functions(folder, environ, home)]


def test_the_script_is_replaced_and_can_be_had_back(dr, theirs, home, capsys):
    assert told(theirs, home) == ["bin/activate.sh"]

    code = dr("init", "--adopt")

    said = capsys.readouterr().err
    assert code == 0
    assert told(theirs, home) == []
    assert (theirs / "bin/activate.sh.bak").read_text() == THEIRS
    assert (theirs / "run.env").read_text() == "DR_WORLD_NAME=reinvent_base\n"
    undo = next(line for line in said.splitlines() if line.startswith("To undo this: "))
    subprocess.run(undo.removeprefix("To undo this: "), shell=True, check=True)
    assert told(theirs, home) == ["bin/activate.sh"]


def test_it_can_be_repeated(dr, theirs, capsys):
    dr("init", "--adopt")
    capsys.readouterr()

    code = dr("init", "--adopt")

    assert code == 0
    assert "adopted already; nothing was changed." in capsys.readouterr().err
    assert not (theirs / "bin/activate.sh.bak1").exists()


@pytest.mark.parametrize(
    ("line", "after"),
    [
        ("source {home}/other/bin/activate.sh", "source '{mine}'"),
        ("[ -f x ] && . ~/other/bin/activate.sh -e fast", "[ -f x ] && . '{mine}' -e fast"),
        ('source "$HOME/other/bin/activate.sh" # mine', "source '{mine}' # mine"),
        ("# source ~/other/bin/activate.sh", "# source ~/other/bin/activate.sh"),
        ("alias dr='cd ~; source ~/other/bin/activate.sh'",) * 2,
        ('echo "; source ~/other/bin/activate.sh"',) * 2,
        ("source ~/other/bin/activate.sh.old",) * 2,
        ("source ~/conda/bin/activate.sh", "source ~/conda/bin/activate.sh"),
    ],
)
def test_a_login_loads_the_adopted_folder_instead(dr, theirs, home, line, after):
    reference(home / "other")
    profile = home / ".profile"
    profile.write_text(f"export A=1\n{line.format(home=home)}\nexport B=2\n")

    dr("init", "--adopt", "--yes")

    mine = theirs / "bin/activate.sh"
    assert profile.read_text() == f"export A=1\n{after.format(mine=mine)}\nexport B=2\n"
    assert told(theirs, home) == []


def test_without_a_terminal_a_login_is_only_told(dr, theirs, home, capsys):
    reference(home / "other")
    (home / ".profile").write_text("source ~/other/bin/activate.sh\n")

    dr("init", "--adopt")

    assert "~/.profile line 1" in capsys.readouterr().err
    assert (home / ".profile").read_text() == "source ~/other/bin/activate.sh\n"
    assert told(theirs, home) == ["~/.profile line 1"]


def test_a_shell_that_it_activated_is_known_by_what_it_exports(theirs, home):
    assert told(theirs, home, DR_TRAIN_COMPOSE_FILE="-c x")[-1] == "environment"
    assert told(theirs, home, **{"BASH_FUNC_dr-start-training%%": "() { :; }"})[-1] == "environment"


def test_a_shell_gets_rid_of_functions_and_copies_of_settings(dr, theirs, home):
    reference(home / "other")
    dr("init", "--adopt")
    lines = (
        "shopt -s expand_aliases; set -eu",
        f"source {home}/other/bin/activate.sh",
        "source bin/activate.sh",
        "type -t dr-start-training droa-get-model dr-update",
        "alias | wc -l",
        'echo "$DR_WORLD_NAME $DR_DIR $DR_MINE ${DR_TRAIN_COMPOSE_FILE-gone}"',
    )

    shell = ["bash", "--norc", "-c", "\n".join(lines)]
    done = subprocess.run(shell, capture_output=True, text=True, timeout=60)

    assert done.stderr == ""
    assert done.stdout.split() == [
        *("file", "file", "function", "0"),
        *("reinvent_base", str(theirs), "kept", "gone"),
    ]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--adopt", "--world", "bean"), 2, "leave the other options out"),
        (("--adopt", "nowhere"), 3, "has no run.env"),
    ],
)
def test_what_cannot_be_adopted_is_refused(dr, theirs, capsys, arguments, code, words):
    assert dr("init", *arguments) == code
    assert words in " ".join(capsys.readouterr().err.split())
    assert (theirs / "bin/activate.sh").read_text() == THEIRS


def test_another_script_is_not_replaced_without_a_question(dr, theirs, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    (theirs / "bin/activate.sh").write_text("echo mine\n")

    dr("init", "--adopt")

    assert "not DeepRacer-for-Cloud's" in capsys.readouterr().err
    assert (theirs / "bin/activate.sh").read_text() == "echo mine\n"
