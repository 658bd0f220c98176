"""Models that DeepRacer on AWS accepts, as files by name."""

import json
from pathlib import Path
from typing import Any

Files = dict[str, bytes]


def accepted_model(**parameters: Any) -> Files:
    """A model that DeepRacer on AWS accepts; parameters change its training_params.yaml."""
    values = {
        "WORLD_NAME": "reinvent_base",
        "TRACK_DIRECTION_CLOCKWISE": False,
        "BODY_SHELL_TYPE": "deepracer",
        "CAR_COLOR": "Red",
        "RACE_TYPE": "TIME_TRIAL",
        **parameters,
    }
    lines = [f"{name}: {json.dumps(v)}" for name, v in values.items() if v is not None]
    name = "30_Step-9000.ckpt"
    entry = {"name": name, "time_stamp": 1.0, "avg_eval_metric": 100.0}
    return {
        "model_metadata.json": json.dumps(
            {
                "action_space": [{"steering_angle": 0, "speed": 1.0, "index": 0}] * 2,
                "action_space_type": "discrete",
                "training_algorithm": "clipped_ppo",
                "sensor": ["FRONT_FACING_CAMERA"],
                "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
                "version": "5",
            }
        ).encode(),
        "reward_function.py": b"import math\n\n\ndef reward_function(params):\n    return 1.0\n",
        "training_params.yaml": "\n".join(["---", *lines, ""]).encode(),
        "ip/hyperparameters.json": b'{"num_episodes_between_training": 20, "loss_type": "huber"}',
        "model/.coach_checkpoint": name.encode() + b"\n",
        "model/deepracer_checkpoints.json": json.dumps(
            {"last_checkpoint": entry, "best_checkpoint": entry}
        ).encode(),
        f"model/{name}.index": b"index",
        f"model/{name}.meta": b"meta",
        f"model/{name}.data-00000-of-00001": b"weights" * 1000,
        "model/model_30.pb": b"graph",
        "metrics/training/training-20261122.json": b'{"metrics": []}',
    }


def write_files(folder: Path, files: Files) -> Path:
    """Write files below a folder."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder
