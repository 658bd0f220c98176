"""What drives in an evaluation: checkpoints and files, in any engine."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import save

from drcli.base.errors import SettingsError
from drcli.exchange.policy_source import PolicySource
from drcli.formats import write_form
from drcli.formats.build_network import weights_of
from drcli.formats.frozen_graph import encode_policy
from drcli.formats.runtimes import EnginePolicy
from drcli.learn.policy import Observation, decide
from drcli.workers.evaluator import enter, entries
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
    frames, scans = write_form.sample_inputs(network.spec, 12)
    seen = Observation.of_arrays(frames, scans, np.empty((12, 0), np.float32))
    noise = np.zeros((12, 2), np.float32)
    return decide(racer.model, seen, noise, np.ones(12, np.bool_)).actions.tolist()


def entered(racer, source):
    config = racer.settings().run
    [entry] = entries(config, "20260102030405", ["0_Step-0.ckpt"], [source])
    return enter(racer.bucket, entry, config)


@pytest.mark.parametrize("runtime", ["torch", "pb", "onnx"])
def test_a_checkpoint_drives_alike_in_every_engine(model, network, runtime):
    if runtime == "onnx":
        pytest.importorskip("onnxruntime")

    racer, metadata = entered(model, PolicySource(runtime))

    assert isinstance(racer.model, EnginePolicy) == (runtime != "torch")
    assert metadata == small_metadata()
    with torch.inference_mode():
        frames, scans = write_form.sample_inputs(network.spec, 12)
    wanted = write_form.torch_outputs(network, frames, scans).argmax(axis=1).tolist()
    assert actions(racer, network) == wanted
    assert len(set(wanted)) > 1


def test_a_file_drives_without_a_model_in_the_bucket(racer, network, graph_file):
    found, metadata = entered(racer, PolicySource("pb", graph_file))

    frames, scans = write_form.sample_inputs(network.spec, 12)
    wanted = write_form.torch_outputs(network, frames, scans).argmax(axis=1).tolist()
    assert actions(found, network) == wanted
    assert metadata == small_metadata()


def test_a_file_that_has_changed_since_it_was_checked_does_not_drive(racer, graph_file):
    with pytest.raises(SettingsError, match="has changed while its evaluation started"):
        entered(racer, PolicySource("pb", graph_file, None, "0" * 64))
