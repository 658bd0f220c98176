"""The records of `TrainingMetrics.json`, and the file as the analysis tools read it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from drcli.base.json_record import Misfit, built, parsed
from drcli.store.bucket import Bucket, ObjectDamaged
from drcli.store.traces import STATUS_LABELS, TracedEpisode

VERSION = 2.0
"""Version of the file's format. Source: the reference simulator."""


@dataclass(frozen=True)
class _Record:
    """What whoever goes on with the file must be able to rely on."""

    metric_time: float
    episode: int
    trial: int
    phase: Literal["training", "evaluation"]
    iteration: int = 0


def read_records(bucket: Bucket, key: str) -> list[dict[str, Any]]:
    """The records of a worker's file.

    Raises:
        ObjectMissing: There is no file.
        ObjectDamaged: It is something else.
    """
    try:
        file = parsed(bucket.get(key))
        if not isinstance(file, dict) or not isinstance(file.get("metrics"), list):
            raise Misfit("it has no list of 'metrics'")
        return [checked(record) for record in file["metrics"]]
    except Misfit as e:
        raise ObjectDamaged(
            f"{bucket.name}/{key} is damaged: {e}.",
            remedy="Go on with `dr-start-training --resume`, which rebuilds it.",
        ) from e


def checked(record: Any) -> dict[str, Any]:
    """A record that can be gone on from, as it is.

    Raises:
        Misfit: It is something else.
    """
    built(_Record, record)
    kept: dict[str, Any] = record
    return kept


def counted_with(records: Sequence[dict[str, Any]]) -> int:
    """With how many episodes an iteration the episodes of a file are numbered, at least.

    Args:
        records: Those of version 0.1.0 have no iteration.
    """
    most = max((r["trial"] for r in records), default=0)
    later = [r for r in records if r.get("iteration", 0) > 0]
    steps = ((r["episode"] - r["trial"]) // r["iteration"] for r in later)
    return int(max(most, *steps, 0))


def write_records(
    bucket: Bucket, key: str, records: Sequence[dict[str, Any]], best_model_metric: str
) -> None:
    """Publish a worker's file."""
    file = {"metrics": records, "version": VERSION, "best_model_metric": best_model_metric}
    bucket.put(key, json.dumps(file).encode())


def traced_record(episode: TracedEpisode, iteration: int, trial: int) -> dict[str, Any]:
    """The record of a training episode, from its trace.

    Args:
        episode: What the trace tells.
        iteration: Of the trace.
        trial: Its place in the iteration, from 1.
    """
    start_ms, end_ms = round(episode.begin_s * 1000), round(episode.end_s * 1000)
    return {
        "reward_score": round(episode.reward),
        "metric_time": end_ms,
        "start_time": start_ms,
        "elapsed_time_in_milliseconds": end_ms - start_ms,
        "episode": episode.number + 1,
        "trial": trial,
        "phase": "training",
        "completion_percentage": min(100, max(0, int(episode.progress))),
        "episode_status": STATUS_LABELS[episode.status],
        "iteration": iteration,
    }
