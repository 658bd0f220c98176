"""A model of the reference that was imported, exported and imported again is the same model."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load as load_tensors

from drcli.convert.build_network import build_policy, weights_of
from drcli.convert.frozen_graph import encode_policy, policy_nodes
from drcli.convert.onnx_graph import encode_onnx
from drcli.learn.policy import Observation
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.transfer.export_forms import encode_training_checkpoint
from droa_models import write_files

from .test_import_model import Importer

MODELS = Path("../shared/reference-models").resolve()

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(not MODELS.is_dir(), reason="the reference's model is not here"),
]


@pytest.fixture
def importer(working_folder, monkeypatch):
    (working_folder / "run.env").write_text("DR_WORLD_NAME=reInvent2019_wide\n")
    return Importer(working_folder, monkeypatch)


def loaded(bucket, prefix):
    design = Design.of_model(ModelStore(bucket, prefix))
    model = build_policy(design.metadata, design.parameters)
    found = CheckpointStore(ModelStore(bucket, prefix)).load_latest()
    assert found is not None
    model.load_state_dict(load_tensors(found.tensors))
    return design, model, found


def likeliest(model):
    """The likeliest actions for 1,000 frames, the same for every model."""
    random = np.random.default_rng(4)
    actions = []
    for _ in range(10):
        small = random.integers(0, 256, (100, 1, 12, 16), np.uint8)
        frames = small.repeat(10, axis=2).repeat(10, axis=3)
        nothing = np.zeros((100, 0), np.float32)
        with torch.inference_mode():
            actions.append(model(Observation.of_arrays(frames, nothing, nothing)).policy.argmax(-1))
    return torch.cat(actions)


def exported(form, name, model, design, tensors):
    """The files of an export."""
    weights, sensors = weights_of(model), design.metadata.sensor
    if form == "pb":
        return {"model_30.pb": encode_policy(weights, model.spec, sensors)}
    if form == "onnx":
        nodes = policy_nodes(weights, model.spec, sensors)
        return {"model_30.onnx": encode_onnx(nodes, "model_30.onnx")}
    written = encode_training_checkpoint(tensors, name, design.metadata, design.parameters)
    return {f"{name}{end}": data for end, data in written.parts.items()}


def test_the_same_actions_and_the_same_weights_bit_for_bit(importer, tmp_path):
    pytest.importorskip("onnx")
    importer.run(MODELS / "model_30.pb", "first")
    design, model, found = loaded(importer.here, "first")
    weights, actions = weights_of(model), likeliest(model)
    assert len(set(actions.tolist())) > 3
    policy = [key for key in weights if key.startswith(("body.", "policy_head."))]
    for form in ("pb", "onnx", "tf-checkpoint"):
        files = exported(form, found.record.name, model, design, found.tensors)
        files["model_metadata.json"] = design.files["model_metadata.json"]

        report = importer.run(write_files(tmp_path / form, files), form)

        _, again, _ = loaded(importer.here, form)
        same = weights_of(again)
        assert all(np.array_equal(weights[key], same[key]) for key in policy), form
        assert torch.equal(actions, likeliest(again)), form
        assert report.checkpoint == "30_Step-0.ckpt"
