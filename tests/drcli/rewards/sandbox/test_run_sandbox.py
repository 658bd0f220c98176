"""Racers' code in a process of its own: whatever it does, the command lives on."""

import tempfile
import time

import psutil
import pytest

from drcli.rewards.sandbox.run_sandbox import Sandbox

pytestmark = pytest.mark.nightly

ENDS = "import os\ndef reward_function(params):\n    os._exit(3)\n"
CRASHES = "import ctypes\ndef reward_function(params):\n    return ctypes.string_at(0)\n"
HANGS = "def reward_function(params):\n    while True:\n        pass\n"
HANGS_ON = """def reward_function(params):
    while True:
        try:
            while True:
                pass
        except:
            pass
"""
STUCK = "def reward_function(params):\n    return float(max(range(10**12)))\n"
DEAF = "import signal\nwhile True:\n    try: signal.pause()\n    except: pass\n"
KILLS = "import os\ndef reward_function(params):\n    os.kill(os.getpid(), 9)\n"
INTERRUPTS = "def reward_function(params):\n    raise KeyboardInterrupt\n"
FORKS = "import os\ndef reward_function(params):\n    return float(os.fork() > 0)\n"
LEAVES_A_CHILD = """import subprocess, sys
from pathlib import Path
CHILD = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
Path("child.txt").write_text(str(CHILD.pid))
def reward_function(params):
    return float(Path(__file__).with_name("request.json").exists())
"""


@pytest.fixture
def begin(request_of, tmp_path):
    """Begin to try a file of that text."""
    running = []

    def start(text: str) -> Sandbox:
        request = request_of(10, call_s=0.5, load_s=30.0 if text != DEAF else 0.5)
        running.append(Sandbox(request, text.encode(), tmp_path))
        return running[-1]

    yield start
    for sandbox in running:
        sandbox.__exit__()


def test_code_that_ends_crashes_or_hangs_is_found_out_with_its_line(begin):
    sandboxes = [begin(text) for text in (ENDS, CRASHES, HANGS, HANGS_ON)]

    failures = [sandbox.result().failures for sandbox in sandboxes]

    assert [[failure.kind for failure in found] for found in failures] == [
        ["ends"],
        ["crashes"],
        ["endless"],
        ["endless"],
    ]
    assert [found[0].line for found in failures[:2]] == [3, 3]
    assert failures[2][0].line in (2, 3)
    assert failures[3][0].line in range(2, 8)
    assert failures[0][0].source == "os._exit(3)"
    assert "exit code 3" in failures[0][0].reason


@pytest.mark.parametrize(("text", "lines"), [(STUCK, {2}), (DEAF, {2, 3, 4})])
def test_what_cannot_be_interrupted_is_named_with_its_line(begin, text, lines):
    """An operation in C, and a loop that swallows every exception while the file is loaded."""
    [failure] = begin(text).result().failures

    assert failure.kind == "endless"
    assert failure.line in lines
    assert "cannot be interrupted" in failure.reason


def test_the_line_is_found_below_a_temporary_folder_with_an_umlaut(begin, tmp_path, monkeypatch):
    (tmp_path / "für 赛道").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "für 赛道"))

    [failure] = begin(ENDS).result().failures

    assert (failure.kind, failure.line) == ("ends", 3)


def test_the_timer_that_ends_workers_leaves_the_sandbox_alone(begin):
    """The sandbox has a watch of its own, which tells the line."""
    text = "import signal\ndef reward_function(params):\n"
    result = begin(f"{text}    return signal.getitimer(signal.ITIMER_PROF)[0]\n").result()

    assert result.failures == []
    assert {value for values in result.values for value in values} == {0.0}


@pytest.mark.parametrize(
    ("text", "words"), [(KILLS, "(SIGKILL)"), (INTERRUPTS, "KeyboardInterrupt")]
)
def test_code_that_has_its_process_ended_is_told_by_the_signal(begin, text, words):
    [failure] = begin(text).result().failures

    assert failure.kind == "ends"
    assert words in failure.reason


def test_copies_that_racers_code_makes_of_its_process_do_not_go_on(begin):
    result = begin(FORKS).result()

    assert result.values == [[1.0] * 10] * 2
    assert {effect.kind for effect in result.effects} == {"process"}


def test_processes_that_racers_code_starts_end_with_the_sandbox(begin, tmp_path):
    sandbox = begin(LEAVES_A_CHILD)
    result = sandbox.result()
    child = int((tmp_path / "child.txt").read_text())

    sandbox.__exit__()

    deadline = time.monotonic() + 10
    while psutil.pid_exists(child) and psutil.Process(child).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline, "the child lives on"
    assert {effect.kind for effect in result.effects} >= {"process", "writes"}


def test_a_result_that_racers_code_has_written_is_refused_with_a_reason(begin):
    text = (
        "import os\nfrom pathlib import Path\n"
        "def reward_function(params):\n"
        "    made = Path(__file__).with_name(f'{os.getpid()}')\n"
        "    made.write_text('{}')\n"  # whole at once, as copies of the process write it too
        "    made.rename(made.with_name('result.json'))\n"
        "    os._exit(0)\n"
    )

    [failure] = begin(text).result().failures

    assert failure.kind == "ends"
    assert "its format is 1, not 2" in failure.reason


def test_secrets_are_kept_from_racers_code(begin, monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("PLAIN", "seen")
    monkeypatch.setattr("drcli.config.secret_environment.hide_process", lambda: None)
    text = (
        "import os\ndef reward_function(params):\n"
        "    return float('AWS_SECRET_ACCESS_KEY' in os.environ) + 2 * ('PLAIN' in os.environ)\n"
    )

    assert begin(text).result().values == [[2.0] * 10] * 2


def test_signals_to_the_command_fail_with_the_line_that_sends_them(begin):
    text = "import os\ndef reward_function(params):\n    os.kill(os.getppid(), 9)\n"

    [failure] = begin(text).result().failures

    assert (failure.kind, failure.line) == ("raises", 3)
    assert "PermissionError" in failure.reason
