"""A model as DeepRacer-for-Cloud leaves it in a bucket: TensorFlow checkpoints and frozen graphs.

Its files have the keys and contents of the reference; the weights come from our own export.
"""

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

import torch
from safetensors.torch import save

from drcli.convert.build_network import build_policy
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.transfer.export_forms import TrainingCheckpoint, encode_training_checkpoint

BEST, LAST, NEWEST = "2_Step-4630.ckpt", "3_Step-7105.ckpt", "4_Step-9500.ckpt"
"""The index trails the pointer by one iteration, as the reference writes them."""

METADATA: dict[str, Any] = {
    "action_space": [{"steering_angle": angle, "speed": 1.2} for angle in (-30, 0, 30)],
    "action_space_type": "discrete",
    "sensor": ["FRONT_FACING_CAMERA"],
    "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_DEEP",
    "training_algorithm": "clipped_ppo",
    "version": "5",
}
HYPERPARAMETERS = {
    "batch_size": 64,
    "beta_entropy": 0.01,
    "discount_factor": 0.99,
    "e_greedy_value": 0.05,
    "epsilon_steps": 10000,
    "exploration_type": "categorical",
    "loss_type": "huber",
    "lr": 0.0003,
    "num_episodes_between_training": 20,
    "num_epochs": 5,
    "stack_size": 1,
    "term_cond_avg_score": 350.0,
    "term_cond_max_episodes": 1000,
}
REWARD = b"def reward_function(params):\n    return float(params['speed'])\n"

TRACE = (
    "episode,steps,X,Y,yaw,steer,throttle,action,reward,done,all_wheels_on_track,progress,"
    "closest_waypoint,track_len,tstamp,episode_status,pause_duration,obstacle_crash_counter,"
    "wall_clock\n"
    "0,1.0,3.0862,0.6804,-0.4123,0,1.2,1,0.0,False,True,0.6,1,17.67,8.5,prepare,0.0,0,1735732800.0\n"
    "0,2.0,3.1062,0.6804,-0.4123,0,1.2,1,1.2,False,True,0.7,1,17.67,8.6,in_progress,0.0,0,"
    "1735732800.1\n"
    "0,3.0,3.1262,0.6804,-0.4123,0,1.2,1,1.2,True,False,0.8,1,17.67,8.7,off_track,0.0,0,"
    "1735732800.2\n"
)


@cache
def training_checkpoint(number: int) -> TrainingCheckpoint:
    """The files of one checkpoint; each number has other weights."""
    metadata = ModelMetadata.from_bytes(json.dumps(METADATA).encode())
    parameters = Hyperparameters.from_bytes(json.dumps(HYPERPARAMETERS).encode(), "file")
    torch.manual_seed(number)
    state = build_policy(metadata, parameters).state_dict()
    weights = save({name: tensor.contiguous() for name, tensor in state.items()})
    return encode_training_checkpoint(weights, "weights", metadata, parameters)


def reference_model(**metadata: Any) -> Mapping[str, bytes]:
    """The objects of a model by their keys below its prefix."""
    described = json.dumps({**METADATA, **metadata}).encode()
    episode = {
        "reward_score": 2,
        "metric_time": 8700,
        "start_time": 8500,
        "elapsed_time_in_milliseconds": 200,
        "episode": 1,
        "trial": 1,
        "phase": "training",
        "completion_percentage": 31,
        "episode_status": "Off track",
    }
    files = {
        "training_params.yaml": b"WORLD_NAME: reinvent_base\nSAGEMAKER_SHARED_S3_BUCKET: bucket\n",
        "reward_function.py": REWARD,
        "ip/ip.json": b'{"IP": "172.18.0.3"}',
        "ip/done": b"done",
        "ip/hyperparameters.json": json.dumps(HYPERPARAMETERS, indent=2).encode(),
        "model/model_metadata.json": described,
        "model/.coach_checkpoint": NEWEST.encode(),
        "model/.ready": b"",
        "model/.finished": b"",
        "model/deepracer_checkpoints.json": json.dumps(
            {
                "best_checkpoint": {"name": BEST, "avg_eval_metric": 64.3, "time_stamp": 1820.25},
                "last_checkpoint": {"name": LAST, "avg_eval_metric": 41.9, "time_stamp": 1933.6},
            }
        ).encode(),
        "metrics/TrainingMetrics.json": json.dumps(
            {"metrics": [episode], "version": 2.0, "best_model_metric": "progress"}
        ).encode(),
        "training-simtrace/0-iteration.csv": TRACE.encode(),
    }
    for name in (BEST, LAST, NEWEST):
        number = int(name.partition("_")[0])
        written = training_checkpoint(number)
        files |= {f"model/{name}{end}": data for end, data in written.parts.items()}
        files[f"model/model_{number}.pb"] = written.graph
    return files
