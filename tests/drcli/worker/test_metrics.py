import json

import pytest

from drcli.store.memory import MemoryBucket
from drcli.worker.metrics import TrainingMetrics
from drcli.worker.trace import Episode, Row

KEY = "model/metrics/TrainingMetrics.json"


@pytest.fixture
def bucket() -> MemoryBucket:
    return MemoryBucket()


def test_trials_restart_each_iteration_and_evaluations_repeat_the_last_episode(bucket):
    metrics = TrainingMetrics(bucket, KEY, "progress")

    for iteration in range(2):
        first = 2 * iteration
        metrics.add([_episode(first), _episode(first + 1)])
        metrics.add([], [_episode(0, "evaluation")])

    records = json.loads(bucket.get(KEY))["metrics"]
    assert [(r["phase"], r["episode"], r["trial"]) for r in records] == [
        ("training", 1, 1),
        ("training", 2, 2),
        ("evaluation", 2, 2),
        ("training", 3, 1),
        ("training", 4, 2),
        ("evaluation", 4, 2),
    ]


def test_a_restarted_worker_continues_the_file_and_forgets_the_iteration_it_repeats(bucket):
    first = TrainingMetrics(bucket, KEY, "progress")
    first.add([_episode(0), _episode(1)])
    first.add([], [_episode(0, "evaluation")])
    first.add([_episode(2), _episode(3)])

    second = TrainingMetrics(bucket, KEY, "progress")
    second.keep_before(2)
    second.add([_episode(2), _episode(3)])

    records = json.loads(bucket.get(KEY))["metrics"]
    assert [r["episode"] for r in records] == [1, 2, 2, 3, 4]


def test_the_clock_goes_on_after_the_last_record(bucket):
    metrics = TrainingMetrics(bucket, KEY, "progress")
    metrics.add([_episode(0)])

    assert TrainingMetrics(bucket, KEY, "progress").clock_s == pytest.approx(1.0)


def _episode(number: int, phase: str = "training") -> Episode:
    row = Row(1, 0.0, 0.0, 0.0, 0.0, 1.0, "0", 0.0, True, True, 50.0, 0, "off_track", 0.0, 1.0)
    return Episode(number, phase, [row])
