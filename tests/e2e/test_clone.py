"""A model that goes on from another one's weights, through the real commands."""

import json

import pytest
from safetensors.numpy import load

from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore

pytestmark = pytest.mark.nightly


def test_an_increment_and_a_start_go_on_from_the_models_weights(workspace, trained):
    workspace.put(trained)
    workspace.hyperparameters["term_cond_max_episodes"] = 1
    workspace.write_custom_files()

    stepped = workspace.run("increment-training", "-f", "--json")
    refused = _start_with_two_actions(workspace)
    cloned = workspace.run("start-training", "--json")

    assert stepped.returncode == 0, stepped.stderr
    step = json.loads(stepped.stdout.splitlines()[-1])
    assert (step["before"], step["after"]) == ("model", "model-1")
    assert refused.returncode == 3
    assert "trained with 3 discrete actions, but action_space has 2" in refused.stderr
    assert cloned.returncode == 0, cloned.stderr + workspace.logs()
    name = step["pretrained"]["name"]
    assert f"with the weights of model (last checkpoint {name})" in cloned.stderr
    report = json.loads(cloned.stdout.splitlines()[-1])
    assert report["prefix"] == "model-1"
    assert [r["checkpoint"] for r in report["history"]] == ["0_Step-0.ckpt"]
    bucket = workspace.bucket()
    source = load(CheckpointStore(ModelStore(bucket, "model")).load(name).tensors)
    first = load(CheckpointStore(ModelStore(bucket, "model-1")).load("0_Step-0.ckpt").tensors)
    learned = CheckpointStore(ModelStore(bucket, "model-1")).load_latest()
    assert all((first[tensor] == source[tensor]).all() for tensor in source)
    assert learned is not None
    assert any((load(learned.tensors)[tensor] != first[tensor]).any() for tensor in first)


def _start_with_two_actions(workspace):
    metadata = workspace.folder / "custom_files" / "model_metadata.json"
    values = json.loads(metadata.read_text())
    metadata.write_text(json.dumps({**values, "action_space": values["action_space"][:2]}))
    refused = workspace.run("start-training")
    workspace.write_custom_files()
    return refused
