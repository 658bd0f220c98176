"""`dr reward`: what people and scripts see of it."""

import json
from pathlib import Path

import pytest
from PIL import Image

import sandbox_here
from drcli.rewards.sandbox.run_sandbox import Sandbox
from sandbox_here import SandboxHere

GOOD = """def reward_function(params):
    return params["speed"] ** 2 * params["all_wheels_on_track"]
"""
BAD = "def reward_function(params):\n    return params['sped']\n"


@pytest.fixture
def racer(working_folder, course, monkeypatch):
    """A working folder whose drive has been driven already, and whose sandbox is this process."""
    monkeypatch.setattr("drcli.rewards.tried_reward.Sandbox", SandboxHere)
    monkeypatch.setattr(sandbox_here, "driven_once", lambda *_: course.drive)
    for module in ("pictures", "compare"):
        monkeypatch.setattr(f"drcli.rewards.{module}.drive", lambda *_: course.drive)
    (working_folder / "custom_files").mkdir()
    (working_folder / "custom_files" / "reward_function.py").write_text(GOOD)
    return working_folder


def test_a_check_tells_scripts_all_and_takes_the_racers_own_file(racer, dr, capsys, monkeypatch):
    monkeypatch.setattr("drcli.rewards.tried_reward.Sandbox", Sandbox)

    code = dr("reward", "check", "--json")

    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 0
    assert told["works"] is True
    assert told["file"] == "custom_files/reward_function.py"
    assert len(told["parameters"]) == 27
    assert {p["name"] for p in told["parameters"] if p["read"]} == {"speed", "all_wheels_on_track"}
    assert [driver["name"] for driver in told["drivers"]][:2] == ["steady", "fast"]
    assert told["returns"] == ["float"]
    assert told["least"]["reward"] == 0.0
    assert told["errors"] == []


@pytest.mark.parametrize("world", ["nope", "no pe"])
@pytest.mark.parametrize("line", ["check", "plot", "compare a.py b.py"])
def test_a_wrong_track_is_blamed_on_the_option(working_folder, dr, capsys, line, world):
    for file in ("a.py", "b.py"):
        (working_folder / file).write_text(GOOD)

    code = dr("reward", *line.split(), "--world", world)

    said = capsys.readouterr().err
    assert code == 2
    assert f"--world {world} " in said
    assert "DR_WORLD_NAME" not in said
    assert "flag" not in said


def test_a_check_of_a_failing_file_names_the_line_and_exits_3(racer, dr, capsys):
    waits = "\n\ndef begins(params):\n    return params['steps'] == 1\n"
    (racer / "bad.py").write_text(BAD + waits)

    code = dr("reward", "check", "bad.py")

    out, err = capsys.readouterr()
    assert code == 3
    assert "Error: bad.py line 2 (V-21)" in out
    assert "Warning: bad.py line 6 (V-24)" in out
    assert "`params['steps'] == 1` is never true" in " ".join(out.split())
    assert "KeyError: 'sped'" in out
    assert "Did you mean `speed`?" in out
    assert "bad.py has 1 error" in err


@pytest.fixture
def two_worlds(racer, course, obstacle_course, monkeypatch):
    """A second worker that has boxes on its road."""
    (racer / "system.env").write_text("DR_WORKERS=3\nDR_TRAIN_MULTI_CONFIG=True\n")
    (racer / "worker-2.env").write_text("DR_RACE_TYPE=OBJECT_AVOIDANCE\n")
    (racer / "worker-3.env").write_text("DR_RACE_TYPE=TIME_TRIAL\n")
    driven = {"TIME_TRIAL": course.drive, "OBJECT_AVOIDANCE": obstacle_course.drive}
    monkeypatch.setattr(sandbox_here, "driven_once", lambda race, _: driven[race.race_type])
    return racer


def test_a_check_tries_the_race_of_each_worker_once(two_worlds, dr, capsys):
    (two_worlds / "lone.py").write_text(
        "def reward_function(params):\n    return 1.0 / (not params['objects_speed'])\n"
    )

    code = dr("reward", "check", "lone.py", "--json")

    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 3
    assert [other["race_type"] for other in told["others"]] == ["OBJECT_AVOIDANCE"]
    [error] = told["errors"]
    assert "OBJECT_AVOIDANCE, step 2, 0.8 % of the lap)" in error["message"]
    assert "359 of 718 calls fail like this." in error["message"]


def test_a_check_says_what_it_tried_and_says_the_same_once(two_worlds, dr, capsys):
    (two_worlds / "bad.py").write_text(BAD)

    dr("reward", "check", "bad.py")

    out = capsys.readouterr().out
    assert "on bean, TIME_TRIAL, " in out
    assert "and on bean, OBJECT_AVOIDANCE, " in out
    assert out.count("(V-21)") == 1


def test_a_plot_is_written_and_says_what_it_replaces(racer, dr, capsys):
    Image.new("L", (1, 1)).save(racer / "reward.png")

    code = dr("reward", "plot", "-f")

    out = capsys.readouterr().out
    assert code == 0
    assert "Picture: reward.png (the old one was replaced)" in out
    with Image.open(racer / "reward.png") as picture:
        assert picture.format == "PNG"


def test_a_failing_function_is_not_drawn(racer, dr, capsys):
    (racer / "bad.py").write_text(BAD)

    code = dr("reward", "plot", "bad.py")

    assert code == 3
    assert "bad.py line 2" in capsys.readouterr().err
    assert not (racer / "reward.png").exists()


def test_a_wrong_value_is_no_lines_doing(racer, dr, capsys):
    (racer / "bad.py").write_text("def reward_function(params):\n    return 'much'\n")

    dr("reward", "plot", "bad.py")

    err = capsys.readouterr().err
    assert "it returned 'much', which is not a number." in err
    assert "The line is" not in err


def test_two_functions_are_compared(racer, dr, capsys):
    (racer / "other.py").write_text("def reward_function(params):\n    return params['x']\n")

    code = dr("reward", "compare", "custom_files/reward_function.py", "other.py", "--json")

    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 0
    assert told["second"] == "other.py"
    assert -1.0 <= told["correlation"] <= 1.0
    assert told["picture"] is None


def test_a_missing_file_is_refused_with_what_to_name_instead(racer, dr, capsys):
    code = dr("reward", "compare", "none.py", "other.py")

    assert code == 3
    said = capsys.readouterr().err
    assert "none.py: this file does not exist" in said
    assert "other.py: this file does not exist" in said


@pytest.mark.parametrize("command", ["check", "plot"])
def test_the_example_is_not_tried_in_place_of_a_missing_file(racer, dr, capsys, command):
    (racer / "custom_files" / "reward_function.py").unlink()
    (racer / "custom_files" / "model_metadata.json").write_text("{}")

    code = dr("reward", command)

    said = capsys.readouterr()
    assert code == 3
    assert "reward_function.py is missing in" in said.err
    assert "which has model_metadata.json" in said.err


def test_without_any_own_file_the_example_is_tried(racer, dr, capsys):
    (racer / "custom_files" / "reward_function.py").unlink()

    assert dr("reward", "check", "--json") == 0


def test_a_world_that_is_not_there_is_refused(working_folder, dr, capsys):
    code = dr("reward", "check", "--world", "bena")

    assert code == 2
    err = capsys.readouterr().err
    assert "--world bena is not a known track" in err
    assert "bean" in err


def test_an_example_is_printed_as_it_was_written(dr, working_folder, capsys):
    before = sorted(working_folder.rglob("*"))

    assert dr("reward", "examples", "speed") == 0

    printed = capsys.readouterr().out
    assert dr("reward", "examples", "speed", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert printed == told["code"] == Path(told["examples"][0]["file"]).read_text("utf-8")
    assert sorted(working_folder.rglob("*")) == before


def test_an_example_that_does_not_exist_leads_to_one_that_does(dr, working_folder, capsys):
    assert dr("reward", "examples", "sped") == 3
    assert "speed" in capsys.readouterr().err
