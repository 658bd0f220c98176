"""A model with a small network and real weights, in a bucket in memory."""

import json
from typing import Any

import torch
from safetensors.torch import save

from drcli.convert.build_network import build_policy
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from evaluations import evaluated
from memory_bucket import MemoryBucket

METADATA: dict[str, Any] = {
    "action_space": [
        {"steering_angle": angle, "speed": speed}
        for angle, speed in ((-30, 1.0), (0, 4.0), (0, 3.9), (30, 1.0))
    ],
    "action_space_type": "discrete",
    "sensor": ["FRONT_FACING_CAMERA"],
    "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
    "training_algorithm": "clipped_ppo",
    "version": "5",
}


def put_small_model(
    bucket: MemoryBucket,
    prefix: str,
    *,
    numbers: tuple[int, ...] = (3, 5),
    parameters: dict[str, Any] | None = None,
    **metadata: Any,
) -> None:
    """Lay down a model whose best checkpoint is the first and whose last is the last number."""
    files = {
        keys.model_metadata(prefix): json.dumps({**METADATA, **metadata}).encode(),
        keys.hyperparameters(prefix): json.dumps(parameters or {}).encode(),
    }
    for key, data in files.items():
        bucket.put(key, data)
    first, second = files.values()
    design = ModelMetadata.from_bytes(first), Hyperparameters.from_bytes(second, "file")
    store = CheckpointStore(ModelStore(bucket, prefix))
    for number in numbers:
        torch.manual_seed(number)
        state = build_policy(*design).state_dict()
        weights = {name: tensor.contiguous() for name, tensor in state.items()}
        record = store.save(number, 100 * number, save(weights), counters=Counters(episodes=number))
        progress = 90.0 if number == numbers[0] else 50.0
        store.record_evaluation(evaluated(record.name, progress), "progress")
    bucket.put(keys.training_start(prefix), b'{"seed": 7, "settings": {}}')
