"""Worlds and the reward function as they are tried before a start."""

import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from threading import Event

import pytest

from drcli.checks.before_start import examine
from drcli.config.loading import load_settings
from drcli.model.files.custom_files import InputFile
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import read_source
from drcli.rewards.sandbox.run_sandbox import Failure, SandboxRequest, SandboxResult
from drcli.rewards.sandbox.sandbox_process import calls_of
from drcli.rewards.try_inputs import races_of, tolerated_share, try_inputs
from sandbox_here import without_trial

ROOT = Path(__file__).resolve().parents[3]

HANGING = "def reward_function(params):\n    while True:\n        pass\n"

KEEPS_STATE = """
START = {}


def reward_function(params):
    if params["steps"] == 2:
        START["progress"] = params["progress"]
    return params["progress"] - START["progress"]
"""


def source_of(code):
    """A reward function that compiles."""
    return read_source(InputFile("reward_function.py", code.encode(), "mine.py"))[0]


@pytest.fixture
def settings(folder):
    """Those of the working folder."""
    return load_settings(folder.path, environ={})


@pytest.fixture
def tried(settings, folder):
    """What is found about a reward function, in a process as when a training starts."""

    def find(before: str, body: str):
        code = f"{before}\n\n\ndef reward_function(params):\n    {body}\n"
        return try_inputs(settings.run, folder.path, source_of(code), Event())

    return find


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("before", "body", "words"),
    [
        ("import os", "os._exit(0)", "The reward function ends the process (exit code 0)."),
        ("import os", "os.killpg(0, 15)", "The reward function ends the process (SIGTERM)."),
        ("", "raise KeyboardInterrupt", "ends the process with KeyboardInterrupt"),
        ("import builtins; builtins.len = None", "return 1.0", "The file replaces builtins.len,"),
    ],
)
def test_code_that_ends_or_breaks_its_process_is_named(tried, before, body, words):
    [found] = tried(before, body)

    assert found.rule == "V-21"
    assert found.where.startswith("mine.py")
    assert words in found.message


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("before", "body"),
    [
        ("import os; os.fork()", "return float(os.fork() > 0)"),
        ("import os, sys; sys.stderr.close(); os.closerange(2, 3)", "return 1.0"),
        ("import sys", "return float(sys.stderr.write('x' * 100_000) > 0)"),
    ],
)
def test_code_that_forks_or_floods_holds_nothing_up(tried, before, body):
    assert [problem for problem in tried(before, body) if problem.severity == "error"] == []


@pytest.mark.nightly
def test_files_of_the_working_folder_are_no_modules(tried, folder):
    (folder.path / "json.py").write_text("raise RuntimeError\n")

    assert tried("import json", "return float(json.loads('1'))") == []


def test_a_sandbox_that_is_given_up_ends_at_once_and_finds_nothing(settings, folder):
    given_up = Event()
    given_up.set()

    assert try_inputs(settings.run, folder.path, source_of(HANGING), given_up) == []


def test_ctrl_c_gives_the_sandbox_up(settings, monkeypatch):
    def wait(_run, _directory, _source, given_up, _metadata):
        ends.append(given_up.wait(60))
        return []

    def interrupt(*_):
        raise KeyboardInterrupt

    ends = []
    monkeypatch.setattr("drcli.checks.before_start.try_inputs", wait)
    monkeypatch.setattr("drcli.checks.before_start.review_disk", interrupt)

    with pytest.raises(KeyboardInterrupt):
        examine(settings, {}, None)

    assert ends == [True]


def test_the_sandbox_gets_the_races_and_nothing_else_of_the_settings(folder, tmp_path):
    folder.write("../worker-2.env", "DR_OA_OBJECT_POSITIONS=0.25,-1;0.5,1\n")
    folder.write("../run.env", "DR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=2\nTEAM_SECRET=hush\n")
    races = races_of(load_settings(folder.path, environ={}).run)

    SandboxRequest("", races=races).write(tmp_path)

    assert SandboxRequest.read(tmp_path).races == races
    assert len(races) == 2
    assert all(b"hush" not in path.read_bytes() for path in tmp_path.glob("*.json"))


def test_the_sandbox_ends_with_its_launcher(settings, tmp_path):
    (tmp_path / "reward_function.py").write_text(HANGING)
    SandboxRequest("", races=races_of(settings.run)).write(tmp_path)
    gone = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], stdout=-1)

    process = subprocess.Popen(
        [
            *(sys.executable, "-P", "-m", "drcli.rewards.sandbox.sandbox_process"),
            *(str(tmp_path), str(int(gone.stdout))),
        ],
        start_new_session=True,
    )

    assert process.wait(60) == -signal.SIGKILL


def test_the_first_call_is_the_first_of_an_episode(settings, try_here):
    found = try_here(settings.run, settings.directory, source_of(KEEPS_STATE), Event())

    assert found == []


SHARED = "import math\n\nLAST = {}\nVERBOSE = False\nTABLE = [1.0] * 117\n"
WORKS = {
    "a bonus for the pace": "return 1e4 * (params['progress'] / params['steps']) ** 3",
    "progress is above 0": "return 1.0 / params['progress']",
    "a difference of two steps": """
    gained = params["progress"] - LAST.get("progress", params["progress"])
    LAST["progress"] = params["progress"]
    return 3e4 * max(0.0, gained)
""",
    "a car is never exactly parallel to the road": """
    ways, (behind, ahead) = params["waypoints"], params["closest_waypoints"]
    (x, y), (next_x, next_y) = ways[behind], ways[ahead]
    road = math.degrees(math.atan2(next_y - y, next_x - x))
    return min(1.0 / abs(params["heading"] - road), 100.0)
""",
    "a car is never exactly on the centre line": (
        "return min(0.01 / params['distance_from_center'], 100.0)"
    ),
    "a lap in few steps": """
    if params["progress"] == 100 and params["steps"] < 60:
        return 1e6
    return 1.0
""",
    "a name that nothing reaches": """
    if VERBOSE:
        print(speeed)
    return 1.0


def helper(params):
    return never_defined
""",
}
FAILS = {
    "past the last waypoint": (
        """
    if params["speed"] >= 1.5:
        return params["waypoints"][params["closest_waypoints"][1] + 2][0]
    return 1.0
""",
        "% len(waypoints)",
    ),
    "a table without the last waypoint": (
        """
    if abs(params["steering_angle"]) < 20:
        return TABLE[params["closest_waypoints"][0]]
    return 1.0
""",
        "% len(waypoints)",
    ),
    "at step 100": ("return 1.0 if params['steps'] != 100 else 1 / 0", "ends where it fails"),
    "at the finish": ("return 1.0 if params['progress'] < 100 else bonus", "Correct the name"),
    "steering and speed": (
        "return 1.0 if params['steering_angle'] * params['speed'] != 24.0 else None",
        "a path without `return` gives None",
    ),
    "an unknown package": ("import cv2_contrib\n    return 1.0", "`pip install cv2_contrib`"),
}


@pytest.fixture(scope="module")
def found_in_start(tmp_path_factory):
    """What a start finds, with the action space that `dr-init` writes; drives once."""
    folder = tmp_path_factory.mktemp("racer")
    (folder / "system.env").write_text("DR_CLOUD=local\n")
    (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\nDR_WORLD_NAME=reinvent_base\n")
    metadata = (ROOT / "defaults" / "model_metadata.json").read_text("utf-8")
    races = races_of(load_settings(folder, environ={}).run)
    request = SandboxRequest("mine.py", races=races, drives=True, metadata=metadata)
    calls = calls_of(request)

    def find(body: str):
        text = f"{SHARED}\n\ndef reward_function(params):\n    {body}\n"
        file = folder / "reward_function.py"
        file.write_text(text)
        with (folder / "faults.txt").open("w") as faults:
            result = without_trial(request, file, calls, faults)
        return problems_of(source_of(text), result, folder)

    return find


@pytest.mark.parametrize("body", WORKS.values(), ids=WORKS)
def test_what_works_in_every_state_that_a_car_can_reach_starts(found_in_start, body):
    assert [each for each in found_in_start(body) if each.severity == "error"] == []


@pytest.mark.parametrize(("body", "remedy"), FAILS.values(), ids=FAILS)
def test_what_fails_later_in_a_lap_does_not_start(found_in_start, body, remedy):
    [error] = [each for each in found_in_start(body) if each.severity == "error"]

    assert remedy in error.remedy


@pytest.mark.nightly
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

    # How long a call takes says something of the processor (V-26).
    assert not [problem for problem in tried(before, body) if problem.rule != "V-26"]
    assert {"numpy", "scipy", "shapely"} <= needed


@pytest.mark.parametrize(
    ("kind", "tolerated", "severity"),
    [
        ("raises", 0.0, "error"),
        ("raises", 0.03, "warning"),
        ("raises", 1.0, "warning"),
        ("range", 0.05, "warning"),
        ("endless", 1.0, "error"),
        ("load", 1.0, "error"),
    ],
)
def test_failures_that_a_training_counts_are_warnings_if_it_is_to_count(kind, tolerated, severity):
    failures = [Failure(kind, "KeyError: 'x'", 3, state="on the road", times=4)]  # 001-17
    result = SandboxResult(failures=failures, calls=100, counted=100)

    [problem] = problems_of(source_of("x = 1"), result, Path(), tolerated)

    assert problem.severity == severity
    assert problem.line == 3
    told = "but ends when more than 3 % of them fail (DR_REWARD_MAX_ERROR_SHARE)."
    assert (told in problem.message) == (tolerated == 0.03)


def test_a_function_that_always_fails_is_refused_although_a_training_counts():
    failures = [Failure(kind, "KeyError: 'x'", 3, times=50) for kind in ("raises", "type")]
    result = SandboxResult(failures=failures, calls=100, counted=100)

    found = problems_of(source_of("x = 1"), result, Path(), 1.0)

    assert [problem.severity for problem in found] == ["error", "error"]
    assert "a training would learn nothing" in found[0].message


@pytest.mark.parametrize(
    ("lines", "share"),
    [
        ("", 0.0),
        ("DR_REWARD_MAX_ERROR_SHARE=0.2\n", 0.0),
        ("DR_REWARD_ON_ERROR=stop\n", 0.0),
        ("DR_REWARD_ON_ERROR=count\n", 1.0),
        ("DR_REWARD_ON_ERROR=count\nDR_REWARD_MAX_ERROR_SHARE=0.2\n", 0.2),
    ],
)
def test_whoever_sets_count_alone_lets_any_share_of_calls_fail(working_folder, lines, share):
    (working_folder / "run.env").write_text(f"DR_WORLD_NAME=reinvent_base\n{lines}")

    run = load_settings(working_folder, environ={}).run

    assert tolerated_share(run) == share
    expected = 0.2 if "0.2" in lines else 1.0 if "count" in lines else 0.05
    assert run.train.reward_max_error_share == expected
