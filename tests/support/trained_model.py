"""A model with real weights in a bucket, for tests of exports and imports."""

import json
from typing import Any

import torch
from safetensors.torch import save

from drcli.bucket.bucket import Bucket
from drcli.convert.build_network import build_policy
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.records.episode_metrics import EpisodeMetrics, encode_metrics
from evaluations import evaluated

DISCRETE = [{"steering_angle": angle, "speed": 1.5} for angle in (-20, 0, 20)]
CONTINUOUS = {
    "steering_angle": {"low": -30, "high": 30},
    "speed": {"low": 1, "high": 3},
}


def put_trained_model(
    bucket: Bucket,
    prefix: str,
    *,
    continuous: bool = False,
    numbers: tuple[int, ...] = (3, 5),
    hyperparameters: dict[str, Any] | None = None,
    workers: int = 1,
    world: str = "reinvent_base",
    **metadata: Any,
) -> torch.nn.Module:
    """Lay down a model whose best checkpoint is the first and whose last is the last number.

    `metadata` are keys of model_metadata.json; the network is the smallest of the reference's.

    Returns:
        The network of the last checkpoint.
    """
    written = {
        "action_space": CONTINUOUS if continuous else DISCRETE,
        "action_space_type": "continuous" if continuous else "discrete",
        "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_DEEP",
        "sensor": ["FRONT_FACING_CAMERA"],
        "training_algorithm": "clipped_ppo",
        "version": "5",
        **metadata,
    }
    design = json.dumps(written).encode()
    parameters = json.dumps(hyperparameters or {}).encode()
    store = CheckpointStore(ModelStore(bucket, prefix))
    for number in numbers:
        torch.manual_seed(number)
        model = build_policy(
            ModelMetadata.from_bytes(design), Hyperparameters.from_bytes(parameters)
        )
        tensors = {name: tensor.contiguous() for name, tensor in model.state_dict().items()}
        record = store.save(number, 100 * number, save(tensors), counters=Counters())
        store.record_evaluation(
            evaluated(record.name, 90.0 if number == numbers[0] else 50.0), "progress"
        )
    bucket.put(keys.model_metadata(prefix), design)
    bucket.put(keys.hyperparameters(prefix), parameters)
    bucket.put(keys.reward_function(prefix), b"def reward_function(params):\n    return 1.0\n")
    for worker in range(workers):
        episodes = [episode(n, worker) for n in range(1, 4)]
        key = keys.training_metrics(keys.metrics_prefix(prefix), worker)
        bucket.put(key, encode_metrics(episodes, "progress"))
    values = f"WORLD_NAME: '{world}'\nREVERSE_DIR: 'False'\nS3_ENDPOINT_URL: http://x\n"
    bucket.put(keys.parameter_file(prefix, "training_params.yaml"), values.encode())
    return model


def episode(number: int, worker: int) -> EpisodeMetrics:
    """One training episode of 1 s; worker 1 ends half a second after worker 0."""
    end_ms = 1000 * number + 500 * worker
    return EpisodeMetrics(
        reward_score=10 * number + worker,
        metric_time=end_ms,
        start_time=end_ms - 1000,
        elapsed_time_in_milliseconds=1000,
        episode=number,
        trial=number,
        phase="training",
        completion_percentage=20,
        episode_status="Off track",
        iteration=0,
    )
