"""What is copied from a running training is complete, though the training goes on."""

import csv
import io
import json

import pytest

from drcli.bucket.bucket import ObjectMissing
from drcli.model import growing_file, keys
from drcli.model.growing_file import list_parts, read_complete
from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.train.learner_metrics import LearnerMetrics, row_of
from iterations import iteration_record
from memory_bucket import MemoryBucket

HISTORY, ROWS = keys.history("model"), keys.learner_metrics("model")


@pytest.fixture
def running(monkeypatch) -> MemoryBucket:
    """A training of 100 iterations whose files have parts."""
    monkeypatch.setattr(growing_file, "SMALL_BYTES", 2000)
    bucket = MemoryBucket()
    history, metrics = (
        History(ModelStore(bucket, "model")),
        LearnerMetrics(ModelStore(bucket, "model")),
    )
    for iteration in range(100):
        history.add(iteration_record(iteration))
        metrics.add(row_of(iteration_record(iteration)))
    assert list_parts(bucket, HISTORY)
    assert list_parts(bucket, ROWS)
    return bucket


def test_a_learning_curve_is_complete(running):
    records = json.loads(read_complete(running, HISTORY))["iterations"]

    assert [record["iteration"] for record in records] == list(range(100))


def test_the_numbers_of_the_learner_are_complete(running):
    rows = list(csv.DictReader(io.StringIO(read_complete(running, ROWS).decode())))

    assert [row["iteration"] for row in rows] == [str(n) for n in range(100)]
    assert {row["losses/entropy"] for row in rows} == {"1"}


def test_a_damaged_file_is_copied_as_it_is(running):
    running.put(HISTORY, b"damaged")

    assert read_complete(running, HISTORY) == b"damaged"


def test_other_files_are_only_read(running):
    running.put("model/metrics/evaluation/evaluation-20260101000000.json", b"{}")

    assert (
        read_complete(running, "model/metrics/evaluation/evaluation-20260101000000.json") == b"{}"
    )
    with pytest.raises(ObjectMissing):
        read_complete(running, "model/metrics/none.json")
