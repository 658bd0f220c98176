"""The graph of a checkpoint lies beside it."""

import torch

from drcli.convert.build_network import build_policy, load_weights, policy_spec
from drcli.convert.frozen_graph import compare_graph
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.train.checkpoint_publisher import write_graph
from memory_bucket import MemoryBucket
from observations import camera_only
from small_model import put_small_model


def test_the_graph_computes_what_the_checkpoint_does():
    bucket = MemoryBucket()
    put_small_model(bucket, "model")
    store, design = (
        CheckpointStore(ModelStore(bucket, "model")),
        Design.of_model(ModelStore(bucket, "model")),
    )
    spec = policy_spec(design.metadata, design.parameters)
    found = store.load("5_Step-500.ckpt")

    write_graph(store, 5, found.tensors, spec, design.metadata.sensor)

    model = build_policy(design.metadata, design.parameters)
    load_weights(model, found.tensors, "5")
    frames = torch.full((2, 1, 120, 160), 99, dtype=torch.uint8)
    graph = bucket.get(keys.checkpoint_graph("model", 5))
    assert compare_graph(graph, model, camera_only(frames), "it").is_equal
