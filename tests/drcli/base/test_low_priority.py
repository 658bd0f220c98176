"""A process of low priority, and what it starts (seeds 001-51, 001-52)."""

import os
import subprocess
import sys

import psutil
import pytest

from drcli.base.processes import NICE

LOWERS = """
import os, subprocess, sys, threading
from pathlib import Path
from drcli.base.processes import lower_priority

said = [lower_priority(Path(sys.argv[1])) for _ in range(2)]
child = subprocess.run([sys.executable, "-c", "import os; print(os.nice(0))"], stdout=-1)
mine = []
thread = threading.Thread(target=lambda: mine.append(os.getpriority(os.PRIO_PROCESS, 0)))
thread.start(); thread.join()
print(os.nice(0), int(child.stdout), *mine)
print(said[0] == said[1], "session" in said[0])
"""


@pytest.mark.parametrize("leads", [True, False])
def test_everything_of_a_process_of_low_priority_has_it_and_no_session_of_others(tmp_path, leads):
    group = tmp_path / "autogroup"
    group.write_text("/autogroup-7 nice 0\n")

    done = subprocess.run(
        [sys.executable, "-c", LOWERS, str(group)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        start_new_session=leads,
    )

    nice, session = done.stdout.splitlines()
    expected = max(NICE, os.getpriority(os.PRIO_PROCESS, 0))
    assert nice.split() == [str(expected)] * 3
    assert session == f"True {leads}"
    assert group.read_text().startswith("10" if leads else "/autogroup-7 nice 0")


def test_a_kernel_without_groups_of_sessions_changes_nothing_else(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", LOWERS, str(tmp_path / "missing")],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        start_new_session=True,
    )

    assert done.stdout.splitlines()[1] == "True False"
    assert psutil.Process().nice() == os.getpriority(os.PRIO_PROCESS, 0)  # this one is as it was
