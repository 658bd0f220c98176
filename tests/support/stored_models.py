"""Models in the folder of the local server, where readers find them without a server."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drcli.model import keys
from drcli.records.episode_metrics import TrialMetrics, encode_metrics_file
from drcli.records.iteration import IterationRecord, encode_history

STAMP = "20260102030405"


class StoredModels:
    """Writes objects of a bucket as files.

    Args:
        working_folder: Of the racer.
        bucket: Its name.
    """

    def __init__(self, working_folder: Path, bucket: str = "bucket") -> None:
        self.folder = working_folder / "data" / "s3" / bucket
        self.folder.mkdir(parents=True, exist_ok=True)

    def put(self, key: str, data: bytes | str | dict[str, Any]) -> Path:
        """Write an object."""
        path = self.folder / key
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(data, dict):
            data = json.dumps(data)
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return path

    def model(self, prefix: str, iterations: int = 2) -> None:
        """A model with some iterations, its files, and two checkpoints."""
        for number in range(2):
            name = f"{number}_Step-{100 * number}.ckpt"
            self.put(keys.checkpoint_tensors(prefix, name), b"weights")
            self.put(keys.checkpoint_record(prefix, name), {})
        score = {"name": "0_Step-0.ckpt", "avg_eval_metric": 42.0}
        last = {"name": "1_Step-100.ckpt", "avg_eval_metric": None}
        self.put(
            keys.deepracer_checkpoints(prefix), {"best_checkpoint": score, "last_checkpoint": last}
        )
        self.put(keys.model_metadata(prefix), {"sensor": ["FRONT_FACING_CAMERA"]})
        self.put(keys.hyperparameters(prefix), {"lr": 0.001})
        self.put(keys.reward_function(prefix), "def reward_function(params):\n    return 1.0\n")
        self.put(keys.training_start(prefix), {"seed": 7, "settings": {}})
        self.put(keys.history(prefix), encode_history(list(map(iteration, range(iterations)))))

    def evaluation(
        self,
        prefix: str,
        stamp: str = STAMP,
        lap_ms: Sequence[int] = (12_345,),
        **changes: Any,
    ) -> None:
        """A stored evaluation with its video, with `changes` to its trials."""
        trials = [trial(number, ms, **changes) for number, ms in enumerate(lap_ms, start=1)]
        self.put(
            keys.evaluation_metrics(keys.metrics_prefix(prefix), stamp), encode_metrics_file(trials)
        )
        self.put(
            keys.recording_of(keys.evaluation_trace(prefix, stamp)),
            {
                "world": "reinvent_base",
                "reverse": False,
                "race_type": "TIME_TRIAL",
                "model": prefix,
                "checkpoint": "0_Step-0.ckpt",
                "racer": "me",
                "color": "Red",
                "off_track_penalty_s": 5.0,
                "collision_penalty_s": 3.0,
            },
        )
        self.put(keys.evaluation_video(prefix, stamp), bytes(range(256)))


def iteration(number: int) -> IterationRecord:
    """One iteration of a learning curve."""
    return IterationRecord(
        iteration=number,
        checkpoint=f"{number}_Step-{100 * number}.ckpt",
        episodes=2,
        steps=100,
        total_steps=100 * (number + 1),
        mean_reward=10.0 + number,
        mean_progress=20.0,
        full_laps=0,
        best_lap_s=None,
        elapsed_s=60.0 * (number + 1),
        evaluation_progress=[50.0, 100.0],
        evaluation_lap_s=[12.5],
    )


def trial(number: int, lap_ms: int, **changes: Any) -> TrialMetrics:
    """A trial that completed its lap and left the track once."""
    fields: dict[str, Any] = {
        "completion_percentage": 100,
        "metric_time": lap_ms,
        "start_time": 0,
        "elapsed_time_in_milliseconds": lap_ms,
        "episode_status": "Lap complete",
        "crash_count": 0,
        "immobilized_count": 0,
        "off_track_count": 1,
        "reversed_count": 0,
        "reset_count": 1,
        "trial": number,
    }
    return TrialMetrics(**{**fields, **changes})
