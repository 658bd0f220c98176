"""Processes that load libraries before they get an order, and those that are divided off them."""

import os
import signal
import subprocess
import sys

import psutil
import pytest

from drcli.base import early_process
from drcli.base.clock import wait_until
from drcli.base.early_process import Order

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only on Linux")

SOON_S = 30.0

EARLY = """
import sys
from drcli.base import early_process

early_process.load("shared", "missing", "first")
early_process.divide_off(int(sys.argv[1]))
early_process.divide("worker")
early_process.load("main")
early_process.obey()
"""

SAYS = """
import os, sys
import shared

print(__name__, sys.argv[1:], sys.stdin.read(), os.environ["COLOUR"], shared.loaded_by)
print(os.getppid(), os.getsid(0) == os.getpid(), flush=True)
sys.exit(7)
"""

MAIN = """
import sys
from drcli.base import early_process
from drcli.base.early_process import Order

early = early_process.taken("worker")
log, *_ = sys.argv[1:]
process = early.give(Order("worker", ["1"], log, {"COLOUR": "red"}), b"job")
print(process.pid, process.wait(20), process.poll(), early_process.taken("worker"))
"""


@pytest.fixture
def started(tmp_path):
    """A process that has divided itself twice; what it imports says where it was loaded."""
    modules = {
        "shared": "import os\nloaded_by = os.getpid()\n",
        "first": SAYS,
        "worker": SAYS,
        "main": MAIN,
    }
    for name, text in modules.items():
        # They are run as programs; when they are loaded before, they do nothing.
        unless = "" if name == "shared" else 'if __name__ != "__main__":\n    raise ImportError\n'
        (tmp_path / f"{name}.py").write_text(unless + text)
    early_process.start(
        [sys.executable, "-c", EARLY],
        "main",
        "first",
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    [waiting] = early_process._waiting
    yield waiting.process
    early_process.dismiss()


def test_a_process_that_was_divided_off_becomes_a_child_and_runs_what_it_is_told(started, tmp_path):
    early = early_process.taken("first")
    assert early is not None
    log = tmp_path / "log"
    log.write_text("before\n")

    process = early.give(Order("first", ["a", "b"], str(log), {"COLOUR": "blue"}), b"a job")

    assert process.wait(SOON_S) == 7
    said = log.read_text().splitlines()
    assert said == [
        "before",
        f"__main__ ['a', 'b'] a job blue {started.pid}",
        f"{os.getpid()} True",
    ]
    assert process.poll() == process.returncode == 7


def test_processes_share_what_was_loaded_before_they_divided(started, tmp_path):
    early = early_process.taken("main")
    assert early is not None

    process = early.give(Order("main", [str(tmp_path / "own")], str(tmp_path / "log"), {}), b"")

    assert process is started
    assert process.wait(SOON_S) == 0
    pid, *rest = (tmp_path / "log").read_text().split()
    assert rest == ["7", "7", "None"]
    assert (tmp_path / "own").read_text().splitlines() == [
        f"__main__ ['1'] job red {started.pid}",
        f"{started.pid} True",
    ]
    assert not psutil.pid_exists(int(pid))


def test_each_is_listed_under_the_name_of_what_it_runs(started, tmp_path):
    (tmp_path / "first.py").write_text("import time\nprint(1, flush=True)\ntime.sleep(600)\n")
    early = early_process.taken("first")
    assert early is not None
    (tmp_path / "log").touch()

    process = early.give(Order("first", ["0"], str(tmp_path / "log"), {}), b"")
    wait_until(lambda: bool((tmp_path / "log").read_text()), patience_s=SOON_S)
    words = psutil.Process(process.pid).cmdline()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.0)
    process.terminate()

    assert process.wait(SOON_S) == -signal.SIGTERM
    process.kill()  # which changes nothing
    assert [word for word in words[1:] if word] == ["-m", "first", "0"]


def test_a_module_that_cannot_be_loaded_says_why_in_its_log(started, tmp_path):
    (tmp_path / "first.py").write_text("import not_there\n")
    early = early_process.taken("first")
    assert early is not None

    process = early.give(Order("first", [], str(tmp_path / "log"), {}), b"")

    assert process.wait(SOON_S) == 1
    assert "No module named 'not_there'" in (tmp_path / "log").read_text()


def test_those_without_an_order_end_when_they_are_dismissed(started):
    first = early_process.taken("first")
    assert first is not None
    own = psutil.Process(started.pid)
    divided = [*own.children(), psutil.Process(first.process.pid)]

    early_process.dismiss()
    first.dismiss()

    assert started.returncode == -signal.SIGKILL
    assert not psutil.wait_procs(divided, timeout=SOON_S)[1]
    assert early_process.taken("main") is None


def test_a_process_that_has_ended_is_not_taken(started):
    started.kill()
    started.wait(SOON_S)

    assert early_process.taken("main") is None
    assert early_process.taken("first") is None


def test_they_end_with_a_command_that_is_killed(tmp_path):
    begin = (
        "import sys, time\nfrom drcli.base import early_process\n"
        "early_process.start([sys.executable, '-c', sys.argv[1]], 'main', 'first')\n"
        "first = early_process.taken('first')\n"
        "print(early_process._waiting[0].process.pid, first.process.pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", begin, EARLY], stdout=subprocess.PIPE, text=True, cwd=tmp_path
    ) as command:
        assert command.stdout is not None
        processes = [psutil.Process(int(pid)) for pid in command.stdout.readline().split()]
        command.kill()

    assert not psutil.wait_procs(processes, timeout=SOON_S)[1]
