"""What drives in an evaluation: checkpoints and files, in any engine."""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from safetensors.torch import save

from drcli.base.errors import SettingsError
from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.convert.runtimes import EnginePolicy
from drcli.drive.evaluator import enter, entries, evaluate, trials_in_time
from drcli.learn.policy import Observation, decide
from drcli.records.evaluation_task import PolicySource, RaceRecording
from drcli.records.job import Job
from drcli.transfer import export_forms
from reference_model import NEWEST, reference_model
from small_policies import metadata_json, small_metadata, small_network


@pytest.fixture
def network():
    return small_network(small_metadata())


@pytest.fixture
def model(racer, network):
    """A racer whose model-1 has the weights of that network."""
    racer.model_metadata(**json.loads(metadata_json()))
    racer.start()
    tensors = save({name: t.contiguous() for name, t in network.state_dict().items()})
    racer.store("model-1").save(0, 0, tensors, optimizer=b"")
    return racer


@pytest.fixture
def graph_file(tmp_path, network):
    path = tmp_path / "policy.pb"
    path.write_bytes(encode_policy(weights_of(network), network.spec, ["FRONT_FACING_CAMERA"]))
    (tmp_path / "policy.model_metadata.json").write_bytes(metadata_json())
    return path


def actions(racer, network):
    frames, scans = export_forms.sample_inputs(network.spec, 12)
    seen = Observation.of_arrays(frames, scans, np.empty((12, 0), np.float32))
    noise = np.zeros((12, 2), np.float32)
    return decide(racer.model, seen, noise, np.ones(12, np.bool_)).actions.tolist()


def entered(racer, source, checkpoint="0_Step-0.ckpt"):
    config = racer.settings().run
    [entry] = entries(config, "20260102030405", [checkpoint], [source])
    return enter(racer.bucket, entry, config)


@pytest.mark.parametrize("runtime", ["torch", "pb", "onnx"])
def test_a_checkpoint_drives_alike_in_every_engine(model, network, runtime):
    if runtime == "onnx":
        pytest.importorskip("onnxruntime")

    racer, metadata = entered(model, PolicySource(runtime))

    assert isinstance(racer.model, EnginePolicy) == (runtime != "torch")
    assert metadata == small_metadata()
    with torch.inference_mode():
        frames, scans = export_forms.sample_inputs(network.spec, 12)
    wanted = export_forms.torch_outputs(network, frames, scans).argmax(axis=1).tolist()
    assert actions(racer, network) == wanted
    assert len(set(wanted)) > 1


def test_a_checkpoint_of_the_reference_drives_as_its_frozen_graph_does(racer, tmp_path):
    files = reference_model()
    for name, data in files.items():
        racer.bucket.put(f"model-1/{name}", data)
    graph = tmp_path / "model_4.pb"
    graph.write_bytes(files["model/model_4.pb"])
    (tmp_path / "model_metadata.json").write_bytes(files["model/model_metadata.json"])

    found, metadata = entered(racer, PolicySource("torch"), NEWEST)

    theirs, _ = entered(racer, PolicySource("pb", graph))
    assert actions(found, found.model) == actions(theirs, found.model)
    assert metadata.neural_network == "DEEP_CONVOLUTIONAL_NETWORK_DEEP"


@pytest.mark.parametrize("runtime", ["torch", "pb"])
def test_a_sac_checkpoint_of_the_reference_drives_with_its_frozen_graph(racer, runtime):
    sac = small_network(small_metadata("sac"))
    graph = encode_policy(weights_of(sac), sac.spec, ["FRONT_FACING_CAMERA"])
    racer.bucket.put("model-1/model/model_metadata.json", metadata_json("sac"))
    racer.bucket.put("model-1/ip/hyperparameters.json", b"{}")
    racer.bucket.put("model-1/model/7_Step-700.ckpt.index", b"variables that ours do not have")
    racer.bucket.put("model-1/model/model_7.pb", graph)

    found, _ = entered(racer, PolicySource(runtime), "7_Step-700.ckpt")

    frames, scans = export_forms.sample_inputs(sac.spec, 12)
    wanted = export_forms.torch_outputs(sac, frames, scans)
    np.testing.assert_allclose(actions(found, sac), wanted, atol=1e-5)


def test_a_file_drives_without_a_model_in_the_bucket(racer, network, graph_file):
    found, metadata = entered(racer, PolicySource("pb", graph_file))

    frames, scans = export_forms.sample_inputs(network.spec, 12)
    wanted = export_forms.torch_outputs(network, frames, scans).argmax(axis=1).tolist()
    assert actions(found, network) == wanted
    assert metadata == small_metadata()


def test_a_file_that_has_changed_since_it_was_checked_does_not_drive(racer, graph_file):
    with pytest.raises(SettingsError, match="has changed while its evaluation started"):
        entered(racer, PolicySource("pb", graph_file, None, "0" * 64))


@pytest.mark.parametrize(("debug", "own"), [("True", True), ("False", False)])
def test_as_many_trials_as_wanted_are_driven_with_ones_own_reward_only_on_request(
    debug, own, racer, network, tmp_path, monkeypatch
):
    racer.model_metadata(**json.loads(metadata_json()))
    reward = tmp_path / "custom_files" / "reward_function.py"
    reward.write_text("def reward_function(params):\n    return 7.25\n")
    lines = (
        "DR_LOCAL_S3_MODEL_PREFIX=model-1",
        "DR_EVAL_MAX_LAP_SECONDS=1",
        "DR_EVAL_NUMBER_OF_TRIALS=4",
        "DR_EVAL_IS_CONTINUOUS=False",
        f"DR_EVAL_DEBUG_REWARD={debug}",
        "DR_RACE_TYPE=OBJECT_AVOIDANCE",
        "DR_OA_NUMBER_OF_OBSTACLES=2",
    )
    racer.run_env(*lines)
    racer.start()
    tensors = save({name: t.contiguous() for name, t in network.state_dict().items()})
    racer.store("model-1").save(0, 0, tensors, optimizer=b"")
    monkeypatch.setattr("drcli.drive.evaluator.open_bucket", lambda *_, **__: racer.bucket)
    config = racer.settings().run
    entry = entries(config, "20260102030405", ["0_Step-0.ckpt"])[0]
    stop_signal = SimpleNamespace(should_stop=lambda: False, step_done=lambda: False)
    job = Job(config, "s", 3, None, tmp_path / "job", launcher_pid=1)

    found = evaluate(job, stop_signal, [entry], threads=1)

    rows = list(csv.DictReader(racer.bucket.get(entry.trace).decode().splitlines()))
    rewards = {float(row["reward"]) for row in rows if float(row["steps"]) > 1.0}
    assert [len(trials) for trials in found.racers] == [4]
    # A car that waits for a penalty to end earns 0, and its function is not called.
    assert (rewards - {0.0} == {7.25}) == own
    assert (7.25 in rewards) == own
    recorded = RaceRecording.decode(racer.bucket.get(entry.recording))
    assert [len(each.poses[0]) for each in recorded.episodes] == [2] * 4
    racer.run_env(*lines, "DR_EVAL_MAX_MINUTES=0.025")
    short = evaluate(replace(job, config=racer.settings().run), stop_signal, [entry], threads=1)
    assert [len(trials) for trials in short.racers] == [1]
    assert "3 trials left out, which would end after DR_EVAL_MAX_MINUTES=0.025." in short.notes

    fresh = evaluate(job, stop_signal, [entry], threads=1, fresh_laps=3)
    others = evaluate(replace(job, seed=4), stop_signal, [entry], threads=1, fresh_laps=3)

    assert [len(trials) for trials in fresh.racers] == [3]
    starts = [trial.start_position for trial in fresh.racers[0]]
    assert [int(3 * start) for start in starts] == [0, 1, 2]
    assert starts != [trial.start_position for trial in others.racers[0]]
    assert {trial.start_position for trial in found.racers[0]} == {0.0}
    assert all(not trial.reset_count and trial.end_waypoint for trial in fresh.racers[0])


@pytest.mark.parametrize(
    ("rows", "most", "kept"),
    [
        ([900], 500, 1),
        ([300, 300, 300], 900, 3),
        ([300, 300, 300], 899, 2),
        ([300, 700, 100], 900, 1),
    ],
)
def test_trials_that_would_end_after_the_limit_of_an_evaluation_do_not_count(rows, most, kept):
    assert trials_in_time(rows, most) == kept
