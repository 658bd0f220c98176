"""A policy of another system drives here, and the command says with which car."""

import json

import torch

from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import PolicySpec
from drsim.car.car_parameters import CAR_SETS

NETWORK = "COMPACT_CONVOLUTIONAL_NETWORK"
METADATA = {
    "action_space": [{"steering_angle": angle, "speed": 1.0} for angle in (-30, 30)],
    "sensor": ["FRONT_FACING_CAMERA"],
    "neural_network": NETWORK,
    "version": "5",
}


def test_an_imported_graph_drives_with_every_car_and_can_be_evaluated(workspace):
    torch.manual_seed(0)
    spec = PolicySpec(2, network=NETWORK)
    graph = encode_policy(weights_of(ActorCritic(spec)), spec, ["FRONT_FACING_CAMERA"])
    source = workspace.folder / "theirs"
    source.mkdir()
    (source / "model_7.pb").write_bytes(graph)
    (source / "model_metadata.json").write_text(json.dumps(METADATA))

    imported = workspace.run("import", "theirs/model_7.pb", "-t", "imported", "-fc", "--json")

    assert imported.returncode == 0, imported.stderr
    report = json.loads(imported.stdout.splitlines()[-1])
    assert report["checkpoint"] == "7_Step-0.ckpt"
    trials = report["trials"]
    assert [trial["car"] for trial in trials["cars"]] == list(CAR_SETS)
    assert {trial["starts"] for trial in trials["cars"]} == {16}
    assert trials["best"] in CAR_SETS
    workspace.write_run_env(DR_LOCAL_S3_MODEL_PREFIX="imported", DR_EVAL_NUMBER_OF_TRIALS=1)
    evaluated = workspace.run("evaluate", "--json")
    assert evaluated.returncode == 0, evaluated.stderr
    assert json.loads(evaluated.stdout.splitlines()[-1])["checkpoint"] == "7_Step-0.ckpt"
