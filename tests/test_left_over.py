"""A test run itself: it fails where a test leaves a process behind, and ends that process."""

import os
import re
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

FORGETFUL = """
import subprocess, sys

SLEEPER = [sys.executable, "-c", "import time; time.sleep(600)"]
DETACHED = ["/bin/sh", "-c", '"$@" >/dev/null 2>&1 & :', "sh", *SLEEPER]

def test_that_leaves_a_child():
    subprocess.Popen(SLEEPER)

def test_that_leaves_a_process_in_its_folder_which_nothing_else_connects_to_it(tmp_path):
    subprocess.run(DETACHED, cwd=tmp_path, env={}, start_new_session=True)

def test_that_leaves_a_process_elsewhere():
    subprocess.run(DETACHED, cwd="/", start_new_session=True)
"""


def test_a_run_that_leaves_processes_fails_and_ends_them(tmp_path):
    conftest = (Path(__file__).parent / "conftest.py").read_text()
    (tmp_path / "conftest.py").write_text(conftest.replace("LEAVE_S = 15.0", "LEAVE_S = 0.5"))
    (tmp_path / "test_forgetful.py").write_text(FORGETFUL)

    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "ignore"],
        cwd=tmp_path,
        env={
            **os.environ,
            "DRCLI_TEST_RUN": str(tmp_path),
            "PYTEST_ADDOPTS": "--basetemp=temporary",
        },
        stdout=subprocess.PIPE,
        text=True,
        timeout=120,
    )

    told = re.findall(r"A test has left process (\d+)", done.stdout)
    assert (done.returncode, len(told)) == (1, 3), done.stdout
    _, alive = psutil.wait_procs(
        [psutil.Process(int(pid)) for pid in told if psutil.pid_exists(int(pid))], timeout=10
    )
    assert all(process.status() == psutil.STATUS_ZOMBIE for process in alive)


LARGEST = 1 << 20
LARGEST_MODEL = 3 << 20
"""Of the weights of a ready-made model; all models together have ten million bytes."""


def test_no_large_file_is_tracked():
    """A download that lies in the folder when everything is added would stay in the history."""
    root = Path(__file__).resolve().parents[1]
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=root, stdout=subprocess.PIPE, text=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("this is not a clone: git is missing or knows no files here")
    names = filter(None, listed.stdout.split("\0"))

    sizes = {n: (root / n).stat().st_size for n in names if (root / n).exists()}
    models = {n for n in sizes if re.fullmatch(r"defaults/models/\w+/model\.safetensors", n)}

    assert [n for n in sizes.keys() - models if sizes[n] > LARGEST] == []
    assert [n for n in models if sizes[n] > LARGEST_MODEL] == []
    assert sum(sizes[n] for n in models) < 10_000_000
