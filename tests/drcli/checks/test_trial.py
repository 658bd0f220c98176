"""A reward function that harms the process it is tried in is told as a finding."""

import os
import re
import signal
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from drcli.checks.before_start import examine
from drcli.checks.check_report import find_tried
from drcli.checks.sandbox.inputs import try_inputs
from drcli.config.settings import load_settings
from drcli.exchange.job import Job
from drcli.modelfiles.custom_files import InputFile

ROOT = Path(__file__).resolve().parents[3]

HANGING = "def reward_function(params):\n    while True:\n        pass\n"

DEAF = "import signal\nwhile True:\n    try: signal.pause()\n    except: pass\n"


@pytest.fixture
def job(folder, tmp_path):
    """A start of the working folder."""
    settings = load_settings(folder.path, environ={})
    return Job(settings.run, "abc", 0, None, None, tmp_path / "trial", os.getpid())


@pytest.fixture
def tried(job):
    """What is found about a reward function, in a process as when a training starts."""

    def find(before: str, body: str):
        code = f"{before}\n\n\ndef reward_function(params):\n    {body}\n"
        return try_inputs(job, InputFile("reward_function.py", code.encode(), "mine.py"), Event())

    return find


@pytest.mark.parametrize(
    ("before", "body", "words"),
    [
        ("import os", "os._exit(0)", "ended the process that tried it (exit code 0)"),
        ("import os", "os.killpg(0, 15)", "ended the process that tried it (exit code -15)"),
        ("", "raise KeyboardInterrupt", "breaks the process that tried it: KeyboardInterrupt"),
        ("import builtins; builtins.len = None", "return 1.0", "breaks the process that tried it:"),
    ],
)
def test_code_that_ends_or_breaks_its_process_is_named(tried, before, body, words):
    [found] = tried(before, body)

    assert (found.rule, found.where) == ("V-21", "mine.py")
    assert words in found.message


@pytest.mark.parametrize(
    ("before", "body"),
    [
        ("import os; os.fork()", "return float(os.fork() > 0)"),
        ("import os, sys; sys.stderr.close(); os.close(2)", "return 1.0"),
        ("import sys", "return float(sys.stderr.write('x' * 100_000) > 0)"),
    ],
)
def test_code_that_forks_or_floods_holds_nothing_up(tried, before, body):
    assert tried(before, body) == []


def test_files_of_the_working_folder_are_no_modules(tried, folder):
    (folder.path / "json.py").write_text("raise RuntimeError\n")

    assert tried("import json", "return float(json.loads('1'))") == []


def test_a_trial_that_is_given_up_ends_at_once_and_finds_nothing(job):
    given_up = Event()
    given_up.set()

    found = try_inputs(job, InputFile("reward_function.py", HANGING.encode(), "mine.py"), given_up)

    assert found == []


def test_ctrl_c_gives_the_trial_up(job, monkeypatch):
    def wait(_job, _reward, given_up):
        ends.append(given_up.wait(60))
        return []

    def interrupt(*_):
        raise KeyboardInterrupt

    ends = []
    monkeypatch.setattr("drcli.checks.before_start.try_inputs", wait)
    monkeypatch.setattr("drcli.checks.before_start.review_disk", interrupt)

    settings = load_settings(job.directory, environ={})
    with pytest.raises(KeyboardInterrupt):
        examine(settings, job, {}, None)

    assert ends == [True]


def test_a_trial_ends_with_its_launcher(job, tmp_path):
    path = tmp_path / "reward_function.py"
    path.write_text(HANGING)
    gone = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], stdout=-1)
    orphaned = replace(job, launcher_pid=int(gone.stdout), folder=tmp_path)

    process = orphaned.spawn(
        [sys.executable, "-P", "-m", "drcli.checks.sandbox.inputs_process", path, "mine.py"],
        start_new_session=True,
    )

    assert process.wait(60) == -signal.SIGKILL


def test_a_loop_that_swallows_its_deadline_is_named(job, tmp_path):
    path = tmp_path / "reward_function.py"
    path.write_text(DEAF)
    script = (
        "import sys, drsim.episode.reward_deadline, drsim.episode.reward\n"
        "import drcli.checks.sandbox.inputs_process as trial\n"
        "from pathlib import Path\n"
        "drsim.episode.reward_deadline.PATIENCE_S = drsim.episode.reward_deadline.REPEAT_S = 0.05\n"
        "drsim.episode.reward._IMPORT_DEADLINE_S = 0.1\n"
        "trial.main(Path(sys.argv[1]), 'mine.py')\n"
    )
    own = replace(job, folder=tmp_path)

    process = own.spawn([sys.executable, "-c", script, path], start_new_session=True)
    process.wait(60)

    [found] = find_tried(tmp_path)
    assert (found.rule, found.where) == ("V-21", "mine.py line 3")
    assert "swallows what is raised to end it" in found.message


def test_a_reward_function_may_import_all_that_the_console_allowed(tried):
    before = """
import math
import random

import numpy
from scipy.spatial import KDTree
from shapely.geometry import LineString, Point
"""
    body = """
    line = LineString(params["waypoints"])
    off = line.distance(Point(params["x"], params["y"]))
    near, _ = KDTree(numpy.array(params["waypoints"])).query([params["x"], params["y"]])
    return math.exp(-off) + float(near) + random.random()
"""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    needed = {re.split("[^a-z]", line)[0] for line in project["dependencies"]}

    assert tried(before, body) == []
    assert {"numpy", "scipy", "shapely"} <= needed
