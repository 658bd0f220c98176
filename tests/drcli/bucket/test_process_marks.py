"""Processes are known again by their command line, in any locale, and can be ended."""

import os
import signal
import subprocess
import sys

import psutil
import pytest

from drcli.bucket.server import server_process

ASKING = """
import sys
from drcli.bucket.server.server_process import is_running

print(is_running(int(sys.argv[1]), sys.argv[2]))
"""


@pytest.fixture
def sleeper(tmp_path):
    """A process that was started for a folder with an umlaut."""
    mark = str(tmp_path / "Müllers Wagen")
    process = subprocess.Popen([sys.executable, "-c", "input()", mark], stdin=subprocess.PIPE)
    yield process, mark
    process.kill()
    process.communicate()


@pytest.mark.parametrize("utf8", ["0", "1"])
def test_a_process_of_a_folder_with_an_umlaut_is_known_in_the_c_locale(sleeper, utf8):
    process, mark = sleeper

    answer = subprocess.run(
        [sys.executable, "-c", ASKING, str(process.pid), mark],
        env={**os.environ, "LC_ALL": "C", "PYTHONUTF8": utf8},
        capture_output=True,
        text=True,
        check=True,
    )

    assert answer.stdout == "True\n"


def test_a_process_whose_program_is_not_laid_out_yet_is_known(sleeper, monkeypatch):
    process, mark = sleeper
    read, answers = psutil.Process.cmdline, [[], []]
    monkeypatch.setattr(
        psutil.Process, "cmdline", lambda own: answers.pop() if answers else read(own)
    )

    assert server_process.is_running(process.pid, mark)


def test_a_process_that_has_ended_is_not_running_before_its_parent_knows(sleeper):
    process, mark = sleeper
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)

    assert not server_process.is_running(process.pid, mark)


def test_a_process_with_the_mark_is_ended_and_any_other_is_left_alone(sleeper):
    process, mark = sleeper

    server_process.end(process.pid, mark + " of another racer")
    assert process.poll() is None

    server_process.end(process.pid, mark)
    assert process.wait(timeout=60) == -signal.SIGTERM
