"""bin/activate.sh in real shells, and the Tab key in them."""

import os
import pty
import select
import shutil
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from fcntl import ioctl
from pathlib import Path

import pyte
import pytest

from drcli.config.new_folder import plan_experiment, plan_folder, write

pytestmark = pytest.mark.nightly

PROGRAMS = Path(sys.executable).parent


def environment(**more: str) -> dict[str, str]:
    """Our environment without settings, and without the programs on PATH."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DR_")}
    path = [part for part in kept["PATH"].split(os.pathsep) if Path(part) != PROGRAMS]
    return {**kept, "PATH": os.pathsep.join(path), "LC_ALL": "C.UTF-8", **more}


@pytest.fixture(params=["bash", "zsh"])
def shell(request) -> str:
    if shutil.which(request.param) is None:
        pytest.skip(f"{request.param} is not installed")
    return str(request.param)


@pytest.fixture
def folder(tmp_path) -> Path:
    """A working folder under a name that shells trip over, with an experiment."""
    folder = tmp_path / "Müllers Auto"
    write(plan_folder(folder, {"DR_LOCAL_S3_MODEL_PREFIX": "first"}))
    write(plan_experiment(folder, "fast", {}))
    return folder


@pytest.fixture
def run(shell, folder) -> Callable[..., "subprocess.CompletedProcess[str]"]:
    """Runs lines of a script in the working folder."""
    options = {"bash": ["--norc", "--noprofile"], "zsh": ["-f"]}[shell]

    def in_shell(*lines: str, **more: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [shell, *options, "-c", "\n".join(lines)],
            cwd=folder,
            env=environment(**more),
            capture_output=True,
            text=True,
            timeout=60,
        )

    return in_shell


def test_a_script_gets_every_setting_and_every_program_without_a_word(run, folder):
    done = run(
        "set -eu",
        "source bin/activate.sh",
        'echo "$DR_DIR|$DR_LOCAL_S3_MODEL_PREFIX|$DR_LOCAL_S3_BUCKET|$(command -v dr-status)"',
    )

    assert done.stderr == ""
    assert done.stdout == f"{folder}|first|bucket|{PROGRAMS / 'dr-status'}\n"


def test_dozens_of_activations_are_like_one(run):
    done = run(
        "source bin/activate.sh; once=$(env | sort)",
        "source bin/activate.sh; source bin/activate.sh; dr-reload; dr-update; dr-update-env",
        '[ "$once" = "$(env | sort)" ] && echo same',
    )

    assert (done.stdout, done.stderr) == ("same\n", "")


def test_an_edit_counts_for_commands_at_once_and_for_the_shell_after_an_update(run):
    done = run(
        "source bin/activate.sh",
        "dr config set -q DR_WORLD_NAME=bean",
        "sed -i '/^DR_UPLOAD_S3_PREFIX=/d' run.env",
        "dr config show --json DR_WORLD_NAME | grep -c bean",
        'echo "$DR_WORLD_NAME $DR_UPLOAD_S3_PREFIX"',
        "dr-update",
        'echo "$DR_WORLD_NAME ${DR_UPLOAD_S3_PREFIX-gone}"',
    )

    assert done.stdout.splitlines()[-3:] == ["1", "reinvent_base upload", "bean gone"]


def test_an_experiment_is_chosen_and_stays_chosen(run, folder):
    done = run(
        "source bin/activate.sh -e fast",
        "dr-reload",
        'echo "$DR_EXPERIMENT_NAME $DR_LOCAL_S3_MODEL_PREFIX $DR_RUN_ID"',
    )

    assert done.stderr == ""
    assert done.stdout == "fast fast 1\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("-e fats", "Did you mean fast?"),
        ("missing.env", "there is no file missing.env"),
        ("broken.env", "broken.env line 1: nonsense has no ="),
        ("-e", "-e needs the name of an experiment. Try: source bin/activate.sh -e NAME"),
        ("-e ''", "-e needs the name of an experiment. Try: source bin/activate.sh -e NAME"),
        ("-e ../x", "../x is not a plain folder name. Try: Write one of fast."),
        ("-x", "-x is not an option or a file. Try: source bin/activate.sh [-e NAME] [FILE]"),
    ],
)
def test_what_goes_wrong_is_one_line_and_the_shell_lives_on(run, folder, arguments, words):
    (folder / "broken.env").write_text("nonsense\n")

    done = run(
        "set -eu",
        f'source bin/activate.sh {arguments} || echo "status $?, ${{DR_DIR-nothing}} is set"',
    )

    assert done.stdout == "status 1, nothing is set\n"
    assert len(done.stderr.splitlines()) == 1
    assert words in done.stderr


def test_arguments_of_a_script_that_mean_nothing_here_are_left_alone(shell, folder):
    (folder / "train.sh").write_text('source bin/activate.sh && echo "$DR_RUN_ID $*"\n')

    done = subprocess.run(
        [shell, "train.sh", "10", "-w", "--verbose"],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )

    assert (done.stdout, done.stderr) == ("0 10 -w --verbose\n", "")


@pytest.mark.parametrize("script", ["bin/activate.sh", "./bin/../bin/activate.sh"])
def test_who_executes_the_script_is_told_to_source_it(shell, folder, script):
    done = subprocess.run(
        [shell, script], cwd=folder, env=environment(), capture_output=True, text=True, timeout=60
    )

    assert done.returncode == 1
    assert done.stderr == (f"activate.sh: it must be sourced, not executed. Try: source {script}\n")


def test_a_shell_that_cannot_use_the_script_says_so_and_lives_on(folder):
    done = subprocess.run(
        ["bash", "--posix", "-c", '. bin/activate.sh; echo "status $?"'],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )

    assert done.stdout == "status 1\n"
    assert done.stderr == "activate.sh: only bash and zsh can use it, not sh. Try: bash\n"


def test_the_script_of_the_checkout_takes_the_folder_one_stands_in(run, folder):
    script = Path(__file__).resolve().parents[2] / "scripts" / "activate.sh"

    done = run(f'source "{script}" && echo "$DR_DIR"', PATH=f"{PROGRAMS}:{os.environ['PATH']}")

    assert (done.stdout, done.stderr) == (f"{folder}\n", "")


INTERACTIVE = {"bash": ["--norc", "--noprofile", "-i"], "zsh": ["-f", "-i"]}
"""Options of a shell that reads no start files."""


class Typist:
    """Types into an interactive shell and looks at its screen."""

    def __init__(self, shell: str, folder: Path, **more: str) -> None:
        self._ours, theirs = pty.openpty()
        ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
        self._process = subprocess.Popen(
            [shell, *INTERACTIVE[shell]],
            cwd=folder,
            env=environment(TERM="xterm", PS1="$ ", HOME=str(folder), **more),
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
        )
        os.close(theirs)
        self._screen = pyte.Screen(120, 24)
        self._stream = pyte.Stream(self._screen)

    def type(self, keys: str) -> None:
        os.write(self._ours, keys.encode())

    def wait_for(self, words: str) -> str:
        """The screen once it shows some words."""
        deadline = time.monotonic() + 30.0
        while words not in (seen := "\n".join(self._screen.display)):
            assert time.monotonic() < deadline, f"waited in vain for {words!r} in:\n{seen}"
            if select.select([self._ours], [], [], 0.2)[0]:
                self._stream.feed(os.read(self._ours, 65536).decode(errors="replace"))
        return seen

    def leave(self) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._ours)


@pytest.fixture
def typist(request, folder) -> Iterator[Typist]:
    """Sits at a shell in the working folder."""
    if shutil.which(request.param) is None:
        pytest.skip(f"{request.param} is not installed")
    somebody = Typist(request.param, folder)
    yield somebody
    somebody.leave()


@pytest.mark.parametrize("typist", ["bash", "zsh"], indirect=True)
def test_a_line_that_was_pasted_with_its_comment_works(typist):
    typist.type("source bin/activate.sh -e fast  # work in the experiment\n")
    typist.type("echo $DR_EXPERIMENT_NAME-$DR_RUN_ID\n")

    typist.wait_for("fast-1")


@pytest.mark.parametrize("typist", ["bash", "zsh"], indirect=True)
def test_a_word_that_somebody_typed_in_vain_is_refused(typist):
    typist.type("source bin/activate.sh fast\n")

    typist.wait_for("activate.sh: fast is not an option or a file. Try: source bin/activate.sh")


@pytest.mark.parametrize("typist", ["bash", "zsh"], indirect=True)
def test_the_tab_key_works_in_an_activated_shell(typist):
    typist.type("source bin/activate.sh; echo rea''dy\n")
    typist.wait_for("ready")

    typist.type("dr start-tr\t")
    typist.wait_for("dr start-training")
    typist.type("\x15dr-tracks show reinvent_b\t")
    typist.wait_for("dr-tracks show reinvent_base")
    typist.type("\x15dr config set DR_CLOUD=az\t")
    typist.wait_for("dr config set DR_CLOUD=azure")
    typist.type("\x15cat run.e\t")
    typist.wait_for("cat run.env")


def test_the_tab_key_works_in_fish(folder):
    if shutil.which("fish") is None:
        pytest.skip("fish is not installed")
    path = f"{PROGRAMS}:{os.environ['PATH']}"
    lines = ["dr start-tr", "dr-status --js", "dr-init --race-type OBJ", "dr-tracks add run.e"]
    script = "; ".join(["dr completion show fish | source", *(f"complete -C '{x}'" for x in lines)])

    done = subprocess.run(
        ["fish", "-N", "-c", script],
        cwd=folder,
        env=environment(PATH=path, HOME=str(folder)),
        capture_output=True,
        text=True,
        timeout=60,
    )

    found = [line.partition("\t")[0] for line in done.stdout.splitlines()]
    assert found == ["start-training", "--json", "OBJECT_AVOIDANCE", "run.env"]
