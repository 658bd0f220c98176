"""Racers' code in a process of its own: whatever it does, the command lives on."""

import tempfile
import time
from pathlib import Path

import psutil
import pytest

from drcli.base.errors import SettingsError
from drcli.checks.sandbox.parent import Hearing, Questions

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
KILLS = "import os\ndef reward_function(params):\n    os.kill(os.getpid(), 9)\n"
INTERRUPTS = "def reward_function(params):\n    raise KeyboardInterrupt\n"
FORKS = "import os\ndef reward_function(params):\n    return float(os.fork() > 0)\n"
LEAVES_A_CHILD = """import subprocess, sys
from pathlib import Path
CHILD = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
Path("child.txt").write_text(str(CHILD.pid))
def reward_function(params):
    return float(Path(__file__).with_name("order.json").exists())
"""


@pytest.fixture
def questions(course) -> Questions:
    return Questions([course.drive.trips[0].calls[:10]], 1, course.drive.waypoints())


@pytest.fixture
def begin(questions, tmp_path):
    """Begin the hearing of a file of that text."""
    begun = []

    def start(text: str) -> Hearing:
        file = tmp_path / f"reward{len(begun)}.py"
        file.write_text(text)
        begun.append(Hearing(file, questions, tmp_path))
        return begun[-1]

    yield start
    for hearing in begun:
        hearing.close()


def test_code_that_ends_crashes_or_hangs_is_found_out_with_its_line(begin):
    hearings = [begin(text) for text in (ENDS, CRASHES, HANGS, HANGS_ON)]

    failures = [hearing.statement().failures for hearing in hearings]

    assert [[(f.kind, f.line) for f in found] for found in failures] == [
        [("ends", 3)],
        [("crashes", 3)],
        [("endless", 2)],
        [("endless", 4)],
    ]
    assert failures[0][0].source == "os._exit(3)"
    assert "exit code 3" in failures[0][0].what


def test_the_line_is_found_below_a_temporary_folder_with_an_umlaut(begin, tmp_path, monkeypatch):
    (tmp_path / "für 赛道").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "für 赛道"))

    [failure] = begin(ENDS).statement().failures

    assert (failure.kind, failure.line) == ("ends", 3)


def test_the_timer_that_ends_workers_leaves_a_hearing_alone(begin):
    """A hearing has a switch of its own, which tells the line."""
    text = "import signal\ndef reward_function(params):\n"
    statement = begin(f"{text}    return signal.getitimer(signal.ITIMER_PROF)[0]\n").statement()

    assert statement.failures == []
    assert {value for values in statement.values for value in values} == {0.0}


@pytest.mark.parametrize(("text", "words"), [(KILLS, "(SIGKILL)"), (INTERRUPTS, "(SIGINT)")])
def test_code_that_has_its_process_ended_is_told_by_the_signal(begin, text, words):
    [failure] = begin(text).statement().failures

    assert failure.kind == "ends"
    assert words in failure.what


def test_copies_that_racers_code_makes_of_its_process_do_not_go_on(begin):
    statement = begin(FORKS).statement()

    assert statement.values == [[1.0] * 10]
    assert {effect.kind for effect in statement.effects} == {"process"}


@pytest.mark.parametrize(
    ("module", "remedy"),
    [
        ("no_such.geometry", "as with `pip install no_such`, or do without"),
        ("line", "Put what you need of line into reward0.py"),
        ("reward_function", "Remove the import"),
    ],
)
def test_a_module_that_is_not_there_has_a_remedy(begin, tmp_path, module, remedy):
    (tmp_path / "line.py").write_text("POINTS = []\n")

    [failure] = begin(f"from {module} import *\n").statement().failures

    assert remedy in failure.remedy


def test_processes_that_racers_code_starts_end_with_the_hearing(begin, tmp_path):
    hearing = begin(LEAVES_A_CHILD)
    statement = hearing.statement()
    child = int((tmp_path / "child.txt").read_text())

    hearing.close()

    deadline = time.monotonic() + 10
    while psutil.pid_exists(child) and psutil.Process(child).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline, "the child lives on"
    assert {effect.kind for effect in statement.effects} >= {"process", "writes"}


def test_a_file_that_is_not_there_is_refused_before_anything_starts(questions, tmp_path):
    with pytest.raises(SettingsError, match=r"none\.py"):
        Hearing(Path("none.py"), questions, tmp_path)
