"""The lessons: what the pages promise is what the runner checks, and what they tell to do works.

`python scripts/lessons` runs them for real, which takes minutes (002-15, 001, 002).
"""

import importlib
import json
import os
import re
import stat
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drsim.episode.load_reward import load_reward_function
from drsim.episode.simulation import Simulation
from drsim.track.worlds import load_track
from written_commands import problem_of

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    return importlib.import_module("lesson_page")


@pytest.fixture(scope="module")
def promises() -> ModuleType:
    return importlib.import_module("lesson_promises")


def test_there_are_five_lessons_and_each_promises_something(pages, promises):
    assert list(pages.LESSONS) == [1, 2, 3, 4, 5]
    assert list(promises.PROMISES) == [1, 2, 3, 4, 5]
    assert all(promises.PROMISES.values())


@pytest.mark.parametrize("number", range(1, 6))
def test_the_page_names_every_number_of_its_promises(pages, promises, number):
    text = " ".join(pages.Lesson.read(pages.LESSONS[number]).text.split())

    for promise in promises.PROMISES[number]:
        for figure in re.findall(r"\d[\d.,]*", promise):
            assert figure in text, f"{figure} of '{promise}' is not on the page"


@pytest.mark.parametrize("number", range(1, 6))
def test_commands_and_files_of_a_lesson_are_right(pages, number, tmp_path):
    lesson = pages.Lesson.read(pages.LESSONS[number])

    assert [problem for line in lesson.commands if (problem := problem_of(line))] == []
    for name, text in lesson.files.items():
        if name.endswith("hyperparameters.json"):
            assert Hyperparameters.from_bytes(text.encode()).problems == ()
        elif name.endswith("model_metadata.json"):
            ModelMetadata.from_bytes(text.encode())
        else:
            assert drives(text, tmp_path) == []


def drives(text: str, folder: Path) -> list[str]:
    """What is wrong with the rewards of a function on a short drive."""
    path = folder / "reward_function.py"
    path.write_text(text)
    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=1,
        reward_function=load_reward_function(path),
        num_threads=1,
    )
    simulation.reset(np.array([0]), np.array([0.0]))
    rewards = [float(simulation.step(np.array([0.0]), np.array([1.5])).reward[0]) for _ in range(8)]
    simulation.close()
    return [] if max(rewards) > 0.0 else [f"no reward: {rewards}"]


PROGRAM = """#!{shell}
echo "$(basename "$0") $*" >>{log}
case "$*" in *--json*) echo '{answer}';; esac
[ "$(basename "$0")" != dr-init ] || mkdir -p racer/custom_files
"""


def test_the_runner_does_what_a_page_says_and_tells_broken_promises(pages, tmp_path, capfd):
    log = tmp_path / "calls"
    answer = {
        "errors": [],
        "warnings": [],
        "drivers": [
            {"name": "steady", "mean": 1.0, "total": 100.0},
            {"name": "fast", "mean": 1.2, "total": 110.0},
            {"name": "weaving", "mean": 0.5, "total": 60.0},
        ],
        "history": [{"steps": 1_000, "evaluation_lap_s": [15.0]}],
        "trials": [{"lap_s": 15.0, "status": "Lap complete"}],
    }
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("dr-init", "dr-config", "dr-reward", "dr-start-training", "dr-evaluate"):
        script = PROGRAM.format(shell="/bin/bash", log=log, answer=json.dumps(answer))
        (programs / name).write_text(script)
        (programs / name).chmod(stat.S_IRWXU)
    lesson = pages.Lesson.read(pages.LESSONS[1])

    environment = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    results = tmp_path / "results"
    results.mkdir()
    done = subprocess.run(
        ["bash"],
        input=lesson.script(),
        text=True,
        cwd=tmp_path,
        env={**environment, "RESULTS": str(results)},
        check=False,
    )

    assert done.returncode == 0
    called = log.read_text().splitlines()
    assert called[0] == "dr-init racer"
    assert called[-1] == "dr-evaluate --json"
    assert "dr-start-training --until-laps 3 --json" in called
    written = tmp_path / "racer/custom_files/reward_function.py"
    assert written.read_text() == lesson.files["custom_files/reward_function.py"]

    checks = importlib.import_module("lesson_promises")
    found = checks.Results.read(results)
    kept = {text: check(found) for text, check in checks.PROMISES[1].items()}
    assert not kept["a slow lap earns more than a fast one"]
    assert kept["the steady driver earns more per step than the weaving one"]
    assert kept["3 of 3 laps, the fastest below 17 s"]
    assert kept["the training ends within 15,000 steps"]
    assert checks.PROMISES[3]["the weaving driver earns least for its lap"](found)


def test_the_runner_lists_its_options():
    answer = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "lessons"), "--help"],
        capture_output=True,
        text=True,
        check=False,
    )

    assert answer.returncode == 0
    assert "--folder" in answer.stdout
