"""Hyperparameters, actions and reward function on the page."""

import json
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drcli.config.new_folder import plan_folder, write
from drcli.model.files.hyperparameters import KEYS


@pytest.fixture
def folder(empty_folder: Path) -> Path:
    write(plan_folder(empty_folder, {}))
    return empty_folder


def put(client: TestClient, path: str, body: dict[str, Any]) -> Any:
    return client.put(path, json={"version": client.get(path).json()["version"], **body})


def read(folder: Path, name: str) -> Any:
    return json.loads((folder / "custom_files" / name).read_text())


def test_each_hyperparameter_is_explained_with_its_limits(client):
    keys = {each["key"]: each for each in client.get("/api/hyperparameters").json()["keys"]}

    assert set(keys) == set(KEYS)
    assert keys["lr"]["kind"] == "number"
    assert "From 1e-08 to 1." in keys["lr"]["help"]
    assert keys["loss_type"]["options"][1:] == ["huber", "mean squared error"]
    assert keys["sac_tau"]["algorithms"] == ["sac"]
    assert keys["gae_lambda"]["algorithms"] == ["clipped_ppo"]
    assert keys["lr"]["algorithms"] == ["clipped_ppo", "sac"]
    assert keys["bootstrap_cut"]["kind"] == "flag"
    assert all(each["help"] and each["placeholder"] for each in keys.values())


def test_hyperparameters_are_changed_one_by_one(client, folder):
    answer = put(client, "/api/hyperparameters", {"values": {"batch_size": 128, "lr": None}})

    assert answer.status_code == 200, answer.text
    values = read(folder, "hyperparameters.json")
    assert values["batch_size"] == 128
    assert "lr" not in values
    assert next(iter(values)) == "batch_size"
    assert answer.json()["backup"] == "hyperparameters.json.bak"


def test_a_wrong_hyperparameter_is_told_and_refused(client, folder):
    before = (folder / "custom_files" / "hyperparameters.json").read_bytes()
    body = {"values": {"discount_factor": 2}}

    checked = client.post("/api/hyperparameters/check", json=body).json()
    answer = put(client, "/api/hyperparameters", body)

    assert [each["key"] for each in checked["problems"]] == ["discount_factor"]
    assert answer.status_code == 422
    assert (folder / "custom_files" / "hyperparameters.json").read_bytes() == before


def test_more_workers_than_episodes_are_told_while_typing(client, folder):
    with (folder / "system.env").open("a") as file:
        file.write("DR_WORKERS=8\n")
    body = {"values": {"num_episodes_between_training": 4}}

    found = client.post("/api/hyperparameters/check", json=body).json()["problems"]

    assert "V-45" in [each["rule"] for each in found]


def test_a_file_that_is_no_json_is_kept_until_it_is_begun_again(client, folder):
    path = folder / "custom_files" / "hyperparameters.json"
    path.write_text('{"lr": 0.0003,')
    broken = client.get("/api/hyperparameters").json()

    refused = put(client, "/api/hyperparameters", {"values": {"lr": 0.0001}})
    again = put(client, "/api/hyperparameters", {"values": {}, "shipped": True})

    assert broken["broken"] is True
    assert refused.status_code == 422
    assert again.status_code == 200
    assert path.with_name("hyperparameters.json.bak").read_text() == '{"lr": 0.0003,'
    assert client.get("/api/hyperparameters").json()["broken"] is False


def test_actions_are_generated_as_by_the_command(client):
    body = {"angles": 3, "speeds": 2, "max_angle": 20, "max_speed": 2}

    made = client.post("/api/metadata/generate", json=body).json()["actions"]

    assert [(each["steering_angle"], each["speed"]) for each in made] == [
        (-20, 1),
        (-20, 2),
        (0, 1),
        (0, 2),
        (20, 1),
        (20, 2),
    ]


@pytest.mark.parametrize(
    "change", [{"angles": 0}, {"speeds": 1.5}, {"max_speed": "fast"}, {"max_angle": 90}]
)
def test_a_wrong_generator_is_refused(client, change):
    body = {"angles": 3, "speeds": 2, "max_angle": 20, "max_speed": 2, **change}

    assert client.post("/api/metadata/generate", json=body).status_code == 422


def test_sac_with_ranges_is_saved_together(client, folder):
    alone = {"values": {"training_algorithm": "sac"}}
    ranges = {"steering_angle": {"low": -20, "high": 20}, "speed": {"low": 1, "high": 2}}
    both = {"values": {"training_algorithm": "sac", "action_space": ranges}}

    refused = put(client, "/api/metadata", alone)
    saved = put(client, "/api/metadata", both)

    assert refused.status_code == 422
    assert saved.status_code == 200, saved.text
    values = read(folder, "model_metadata.json")
    assert values["action_space_type"] == "continuous"
    assert values["neural_network"] == "COMPACT_CONVOLUTIONAL_NETWORK"


def test_hyperparameters_that_do_not_fit_the_algorithm_are_told(client):
    put(client, "/api/hyperparameters", {"values": {"exploration_type": "additive_noise"}})

    found = client.post("/api/metadata/check", json={"values": {}}).json()["problems"]

    assert "V-34" in [each["rule"] for each in found]


def test_a_problem_of_an_action_names_it(client):
    actions = [{"steering_angle": 0, "speed": 1}, {"steering_angle": 10, "speed": "x"}]

    found = client.post("/api/metadata/check", json={"values": {"action_space": actions}}).json()

    assert found["problems"][0]["key"] == "action_space[1].speed"


def test_a_reward_function_is_saved_as_it_is(client, folder):
    text = "def reward_function(params):\n    return 1.0  # grün\n"

    answer = put(client, "/api/reward", {"text": text})

    assert answer.status_code == 200, answer.text
    assert (folder / "custom_files" / "reward_function.py").read_text("utf-8") == text
    assert client.get("/api/reward").json()["text"] == text


def test_a_reward_function_that_changed_on_the_disk_is_kept(client, folder):
    version = client.get("/api/reward").json()["version"]
    path = folder / "custom_files" / "reward_function.py"
    path.write_text("def reward_function(params):\n    return 2.0\n")

    answer = client.put("/api/reward", json={"text": "x = 1\n", "version": version})

    assert answer.status_code == 409
    assert "2.0" in path.read_text()
    assert not path.with_name("reward_function.py.bak").exists()


def test_the_first_own_file_brings_the_other_two(client, folder):
    for path in (folder / "custom_files").iterdir():
        path.unlink()
    shipped = client.get("/api/reward").json()

    answer = put(client, "/api/reward", {"text": shipped["text"]})

    assert (shipped["origin"], shipped["version"]) == ("shipped", "")
    assert sorted(path.name for path in (folder / "custom_files").iterdir()) == [
        "hyperparameters.json",
        "model_metadata.json",
        "reward_function.py",
    ]
    assert len(answer.json()["others"]) == 2


def test_templates_are_those_that_are_shipped(client):
    found = client.get("/api/reward/templates").json()

    names = [each["name"] for each in found["templates"]]
    assert {"middle", "speed", "object avoidance", "head to bot", "milestones"} <= set(names)
    assert all("def reward_function" in each["text"] for each in found["templates"])
    assert all(each["about"] for each in found["templates"])
    assert "progress" in [name for name, *_ in found["parameters"]]
