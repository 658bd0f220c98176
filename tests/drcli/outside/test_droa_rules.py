"""What DeepRacer on AWS refuses, said before anything is sent."""

import json

import pytest

from drcli.convert.droa_rules import package_problems
from droa_models import accepted_model

METADATA = "model_metadata.json"
HYPERPARAMETERS = "ip/hyperparameters.json"


def errors(files):
    return [each.message for each in package_problems(files) if each.severity == "error"]


def warnings(files):
    return [each.message for each in package_problems(files) if each.severity == "warning"]


def with_json(files, name, **changes):
    """A model with other values in one of its JSON files."""
    values = {**json.loads(files[name]), **changes}
    return {**files, name: json.dumps({k: v for k, v in values.items() if v is not ...}).encode()}


def obstacles(count, *positions):
    """The parameters of a race with obstacles."""
    return {
        "RACE_TYPE": "OBJECT_AVOIDANCE",
        "NUMBER_OF_OBSTACLES": count,
        "OBJECT_POSITIONS": list(positions),
    }


def test_a_model_that_is_accepted_has_no_problem():
    assert package_problems(accepted_model()) == []


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (METADATA, "model_metadata.json is missing"),
        ("reward_function.py", "reward_function.py is missing"),
        ("training_params.yaml", "training_params.yaml is missing"),
        (HYPERPARAMETERS, "ip/hyperparameters.json is missing"),
        ("model/.coach_checkpoint", "model/.coach_checkpoint is missing"),
        ("model/30_Step-9000.ckpt.meta", "30_Step-9000.ckpt.meta is missing"),
        ("model/30_Step-9000.ckpt.index", "30_Step-9000.ckpt.index is missing"),
        ("model/30_Step-9000.ckpt.data-00000-of-00001", "data-00000-of-00001 is missing"),
    ],
)
def test_a_file_that_is_missing_is_named(model, name, words):
    del model[name]

    assert any(words in message for message in errors(model))


def test_a_file_in_the_wrong_place_is_named(model):
    model["hyperparameters.json"] = model.pop(HYPERPARAMETERS)

    (message,) = errors(model)
    assert "hyperparameters.json is not read" in message


@pytest.mark.parametrize("name", [METADATA, "reward_function.py", "model/30_Step-9000.ckpt.index"])
def test_an_empty_file_is_named(model, name):
    model[name] = b""

    assert any(f"{name} is empty" in message for message in errors(model))


def test_checkpoints_of_drcli_need_to_be_exported(model):
    ends = (".index", ".meta", ".data-00000-of-00001")
    for end in ends:
        del model[f"model/30_Step-9000.ckpt{end}"]
    model["model/30_Step-9000.ckpt.safetensors"] = b"weights"

    (found,) = [each for each in package_problems(model) if each.severity == "error"]
    assert "drcli's own format" in found.message
    assert "dr-export droa" in found.remedy


def test_an_archive_for_the_car_is_recognised():
    (message,) = errors({"agent/model.pb": b"graph", METADATA: b"{}"})[:1]

    assert "archive for the car" in message


def test_an_index_that_names_another_checkpoint_is_refused(model):
    entry = {"name": "12_Step-400.ckpt"}
    model["model/deepracer_checkpoints.json"] = json.dumps({"best_checkpoint": entry}).encode()

    assert len(errors(model)) == 3
    assert all("12_Step-400.ckpt" in message for message in errors(model))


def test_a_pointer_to_nothing_is_refused(model):
    model["model/.coach_checkpoint"] = b"../../etc/passwd"

    assert any("not a checkpoint" in message for message in errors(model))


def test_sizes_are_limited(model, monkeypatch):
    monkeypatch.setattr("drcli.convert.droa_rules.MOST_BYTES", 10_000)
    model["more"] = bytes(10_000)
    assert any("GB together" in message for message in errors(model))

    many = {**accepted_model(), **{f"logs/{n}": b"x" for n in range(1000)}}
    assert any("only the first 1,000" in message for message in errors(many))


def test_parameters_of_more_than_ten_megabytes_are_refused(model):
    model["training_params.yaml"] += b"# " + b"x" * (10 << 20)

    (message,) = errors(model)
    assert "at most 10 MB" in message


def test_a_model_without_metrics_gets_a_warning(model):
    model["metrics/TrainingMetrics.json"] = model.pop("metrics/training/training-20261122.json")

    assert errors(model) == []
    assert any("no reward graph" in message for message in warnings(model))


@pytest.mark.parametrize("name", [METADATA, HYPERPARAMETERS])
@pytest.mark.parametrize("data", [b"{", b"[]", b"5", b"\xff", b"[" * 100_000])
def test_json_that_cannot_be_read_is_named(model, name, data):
    model[name] = data

    assert any(f"{name} cannot be read" in message for message in errors(model))


@pytest.mark.parametrize("data", [b"- a list", b"a: [", b"\xff\xfe\x00", b"x", b"? [1]\n: 2"])
def test_yaml_that_cannot_be_read_is_named(model, data):
    model["training_params.yaml"] = data

    assert any("cannot be read" in message for message in errors(model))


CONTINUOUS = {
    "action_space": {
        "steering_angle": {"low": -30, "high": 30},
        "speed": {"low": 0.5, "high": 2.0},
    },
    "action_space_type": "continuous",
}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"action_space": []}, "lacks speed or steering_angle"),
        ({"action_space": [{"speed": 1}]}, "lacks speed or steering_angle"),
        ({"action_space": [5]}, "lacks speed or steering_angle"),
        ({"action_space": ...}, "action_space is missing"),
        ({"training_algorithm": "sac"}, "needs continuous actions"),
        ({"action_space": {"speed": {"low": 1, "high": 2}}}, "steering_angle has no low and high"),
        (
            {"action_space": {**CONTINUOUS["action_space"], "speed": {"low": 2, "high": 2}}},
            "low must be less than high",
        ),
        (
            {"action_space": {**CONTINUOUS["action_space"], "speed": {"low": "a", "high": 2}}},
            "speed has no low and high",
        ),
    ],
)
def test_actions_that_do_not_work_are_refused(model, changes, words):
    assert any(words in message for message in errors(with_json(model, METADATA, **changes)))


@pytest.mark.parametrize(("episodes", "accepted"), [(1, True), (20, False), (True, False)])
def test_sac_learns_after_every_episode(model, episodes, accepted):
    model = with_json(model, METADATA, training_algorithm="sac", **CONTINUOUS)
    model = with_json(model, HYPERPARAMETERS, num_episodes_between_training=episodes)

    assert (errors(model) == []) == accepted


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"WORLD_NAME": "arctic_open_cw"}, "names a direction"),
        ({"WORLD_NAME": "reinvent_bas"}, "is not a track"),
        ({"WORLD_NAME": "reInvent2019_Wide"}, "is not a track"),
        ({"WORLD_NAME": None}, "is not a track"),
        ({"WORLD_NAME": "arctic_open", "TRACK_DIRECTION_CLOCKWISE": None}, "is missing"),
        ({"WORLD_NAME": "arctic_open", "TRACK_DIRECTION_CLOCKWISE": "true"}, "counts as false"),
        ({"WORLD_NAME": "arctic_open", "TRACK_DIRECTION_CLOCKWISE": 1}, "counts as false"),
        ({"CAR_COLOR": "Yellow"}, "does not exist for the shell"),
        ({"RACE_TYPE": "OBJECT_AVOIDANCE"}, "NUMBER_OF_OBSTACLES=None"),
        ({"RACE_TYPE": "OBJECT_AVOIDANCE", "NUMBER_OF_OBSTACLES": 7}, "not from 1 to 6"),
        ({"RACE_TYPE": "OBJECT_AVOIDANCE", "NUMBER_OF_OBSTACLES": "3"}, "without quotes"),
        (obstacles(2, "0.2,1"), "There are 1 OBJECT_POSITIONS"),
        (obstacles(2, "0.2,1", "0.25,-1"), "of the lap apart"),
        (obstacles(1, "0.95,1"), "they must stand"),
        (obstacles(1, "start"), "is not a list of texts"),
    ],
)
def test_races_that_it_does_not_have_are_refused(parameters, words):
    found = errors(accepted_model(**parameters))

    assert len(found) == 1
    assert words in found[0]


@pytest.mark.parametrize(
    "parameters",
    [
        {"WORLD_NAME": "arctic_open", "TRACK_DIRECTION_CLOCKWISE": True},
        {"WORLD_NAME": "reinvent_base", "TRACK_DIRECTION_CLOCKWISE": "text"},
        {"CAR_COLOR": "black"},
        {"BODY_SHELL_TYPE": "f1_2021", "CAR_COLOR": None},
        obstacles(6, "0.07,1", "0.2,-1", "0.33,1", "0.46,1", "0.59,1", "0.9,1"),
        {**obstacles(2, "0.2,1"), "RANDOMIZE_OBSTACLE_LOCATIONS": True},
    ],
)
def test_races_that_it_has_are_accepted(parameters):
    assert package_problems(accepted_model(**parameters)) == []


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"RACE_TYPE": "HEAD_TO_BOT"}, "is imported as TIME_TRIAL"),
        ({"TRACK_DIRECTION_CLOCKWISE": True}, "can only be driven counterclockwise"),
        ({"CAR_COLOR": "Magenta"}, "will be white"),
        ({"BODY_SHELL_TYPE": "tank"}, "will be a white deepracer"),
    ],
)
def test_what_it_changes_without_a_word_is_a_warning(parameters, words):
    model = accepted_model(**parameters)

    assert errors(model) == []
    assert len(warnings(model)) == 1
    assert words in warnings(model)[0]


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("def reward_function(params):\n  return 1.0\nimport os\n", "imports os"),
        ("from pathlib import Path\ndef reward_function(params): return 1.0", "imports pathlib"),
        ("def reward(params): return 1.0", "no function reward_function"),
        ("def reward_function(params) return 1.0", "is not Python in line 1"),
        ("def reward_function(params): return 1.0\n#" + "x" * 140_000, "at most 140,000"),
    ],
)
def test_reward_functions_that_it_does_not_allow_are_refused(model, code, words):
    model["reward_function.py"] = code.encode()

    (message,) = errors(model)
    assert words in message


def test_libraries_that_it_has_may_be_imported(model):
    model["reward_function.py"] = (
        b"import math, random\nimport numpy as np\nfrom scipy.spatial import distance\n"
        b"from shapely.geometry import Point\n\ndef reward_function(params):\n    return 1.0\n"
    )

    assert package_problems(model) == []
