"""What the records of a long training cost, without driving and learning.

It adds iterations to the three files that grow, with the classes of the workers and a bucket that
only counts. Processor time, writes and bytes are means of an iteration in each quarter; memory is
that of Python objects at the end of the quarter.
"""

import time
import tracemalloc
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from drcli.bucket.bucket import Listing, ObjectInfo, ObjectMissing, Watch
from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.records.iteration import IterationRecord
from drcli.records.scores import EvaluationResult
from drcli.records.trace import Episode, Row
from drcli.train.drive_results import TrainingMetrics
from drcli.train.episode_share import Share
from drcli.train.learner_metrics import LearnerMetrics, row_of

EPISODES, TRIALS = 20, 20
"""Of an iteration and of an evaluation, as in the shipped files."""

EVALUATED_EVERY = 5


class CountingBucket:
    """Counts what is written, and keeps nothing."""

    name = "counted"

    def __init__(self) -> None:
        self.writes = self.sent_bytes = 0

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """There are no objects."""
        raise ObjectMissing(key, remedy="")

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """There are no objects."""
        raise ObjectMissing(key, remedy="")

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """Count."""
        self.writes += 1
        self.sent_bytes += len(data)

    def delete(self, keys: Iterable[str]) -> None:
        """Count."""
        self.writes += 1

    def exists(self, key: str) -> bool:
        """There are no objects."""
        return False

    def list(self, folder: str) -> Listing:
        """There are no objects."""
        return list[ObjectInfo]()


def measure(iterations: int) -> dict[str, list[dict[str, float]]]:
    """The cost of an iteration in each quarter, for each of the files."""
    return {
        "history.json": _quarters(iterations, _history),
        "learner.csv": _quarters(iterations, _learner),
        "TrainingMetrics.json": _quarters(iterations, _metrics),
    }


def _quarters(iterations: int, make: Any) -> list[dict[str, float]]:
    bucket = CountingBucket()
    tracemalloc.start()
    add = make(bucket)
    found = []
    for quarter in range(4):
        first, end = (iterations * (quarter + k) // 4 for k in (0, 1))
        writes, sent_bytes, began_s = bucket.writes, bucket.sent_bytes, time.process_time()
        for iteration in range(first, end):
            add(iteration)
        count = end - first
        found.append(
            {
                "cpu_ms": 1000 * (time.process_time() - began_s) / count,
                "writes": (bucket.writes - writes) / count,
                "sent_kb": (bucket.sent_bytes - sent_bytes) / count / 1e3,
                "memory_mb": tracemalloc.get_traced_memory()[0] / 1e6,
            }
        )
    tracemalloc.stop()
    return found


def _record(iteration: int) -> IterationRecord:
    x = (iteration * 0.618) % 1.0
    return IterationRecord(
        iteration=iteration,
        checkpoint=f"{iteration}_Step-{3000 * iteration}.ckpt",
        episodes=EPISODES,
        steps=3000,
        total_steps=3000 * (iteration + 1),
        mean_reward=100 * x,
        mean_progress=50 + 40 * x,
        full_laps=3,
        best_lap_s=12 + x,
        **dict.fromkeys(("entropy", "surrogate_loss", "value_loss", "kl", "learn_s"), x),
        **dict.fromkeys(("steps_per_s", "real_time_factor", "drive_s", "exchange_s"), 3 * x),
        elapsed_s=7.0 * iteration + x,
    )


def _history(bucket: CountingBucket) -> Any:
    history = History(ModelStore(bucket, "model"))

    def add(iteration: int) -> None:
        history.add(_record(iteration))
        if iteration % EVALUATED_EVERY == 0:
            name, trials = f"{iteration}_Step-{3000 * iteration}.ckpt", [100.0 / 3] * TRIALS
            history.add_evaluation(iteration, EvaluationResult(name, trials, trials, [12.5]))
        history.collapse(None)

    return add


def _learner(bucket: CountingBucket) -> Any:
    metrics = LearnerMetrics(ModelStore(bucket, "model"))
    return lambda iteration: metrics.add(row_of(_record(iteration)))


def _metrics(bucket: CountingBucket) -> Any:
    metrics = TrainingMetrics(bucket, "model/metrics", "progress", Share(0, 1, EPISODES))
    row = Row(1, 0.5, 0.5, 10.0, 0.0, 1.0, "0", 1.0, True, True, 55.5, 7, "off_track", 0.0, 9.875)

    def add(iteration: int) -> None:
        metrics.keep_before(iteration)
        clock_s = metrics.clock_s
        made = [
            Episode(n, "training", [replace(row, reward=float(n))], clock_s + 10 * n)
            for n in range(EPISODES)
        ]
        metrics.add(iteration, made)
        if iteration % EVALUATED_EVERY == 0:
            trials = [Episode(n, "evaluation", [row], metrics.clock_s) for n in range(TRIALS)]
            metrics.add(iteration, [], trials)

    return add
