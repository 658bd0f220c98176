"""What repair does with records of a newer version, and with damaged ones beside them."""

from collections import Counter

import pytest

from drcli.base.json_record import Fingerprint
from drcli.bucket.bucket import ObjectNewer, Watch
from drcli.model import keys
from drcli.model.best_checkpoint import write_evaluation
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import write_history
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import reconstruct_scores
from drcli.model.repair import repair, set_aside
from drcli.records.checkpoint import CheckpointRecord
from drcli.records.scores import EvaluationResult
from iterations import iteration_record
from memory_bucket import MemoryBucket

NAME = "0_Step-0.ckpt"


class CountingBucket(MemoryBucket):
    """Counts how often each object is read."""

    def __init__(self) -> None:
        super().__init__()
        self.reads: Counter[str] = Counter()

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        self.reads[key] += 1
        return super().get(key, watch=watch)


@pytest.fixture
def bucket() -> CountingBucket:
    """A model with a checkpoint whose record has a newer format."""
    bucket = CountingBucket()
    bucket.put(keys.checkpoint_tensors("model", NAME), b"weights")
    record = CheckpointRecord(NAME, Fingerprint.of(b"weights")).encode()
    bucket.put(keys.checkpoint_record("model", NAME), record[:-1] + b', "format": 2}')
    bucket.put(keys.lease("model"), b'{"format": 2}')
    bucket.put(keys.status("model", "trainer"), b'{"format": 2}')
    return bucket


def contents(bucket: MemoryBucket) -> dict[str, bytes]:
    return {info.key: MemoryBucket.get(bucket, info.key) for info in bucket.list("")}


def test_records_of_a_newer_version_are_no_damage_and_stay(bucket):
    model, before = ModelStore(bucket, "model", "metrics/model"), contents(bucket)

    assert repair(model) == []
    assert contents(bucket) == before


def test_nothing_is_reconstructed_from_records_that_cannot_be_read(bucket):
    bucket.put(keys.history("model"), b"{")
    model, before = ModelStore(bucket, "model", "metrics/model"), contents(bucket)

    with pytest.raises(ObjectNewer, match="newer version of drcli"):
        repair(model)

    assert contents(bucket) == before


def test_a_damaged_object_is_kept_as_it_was(bucket):
    for key in (keys.checkpoint_record("model", NAME), keys.lease("model")):
        bucket.delete([key])
    status = keys.status("model", "trainer")
    bucket.put(status, b"{")
    bucket.reads.clear()

    [told] = repair(ModelStore(bucket, "model", "metrics/model"))

    assert f"{status} is damaged: Input data was truncated" in told
    kept = [data for key, data in contents(bucket).items() if "/damaged/" in key]
    assert kept == [b"{"]
    assert bucket.reads[status] == 4  # what is wrong; whether anything is newer, three times


def test_of_many_damaged_objects_the_newest_are_kept(monkeypatch):
    monkeypatch.setattr("drcli.model.repair.KEPT_DAMAGED", 5)
    seconds = iter(range(10**6))
    bucket = MemoryBucket(clock=lambda: float(next(seconds)))
    for number in range(20):
        key = keys.evaluation_result("model", number)
        set_aside(ModelStore(bucket, "model"), key, b"damaged")

    kept = sorted(info.key.split("/")[-1].split(".")[0] for info in bucket.list("runs/"))
    assert kept == ["15", "16", "17", "18", "19"]


@pytest.mark.parametrize(
    ("last", "best"), [("short", "1_Step-100.ckpt"), ("long", "2_Step-200.ckpt")]
)
def test_reconstructed_scores_compare_only_laps_of_the_newest_track(last, best):
    bucket = MemoryBucket()
    store = CheckpointStore(ModelStore(bucket, "model"))
    for number, world in enumerate(("short", "short", last)):
        store.save(number, 100 * number, b"weights")
        laps = [8.0] * 5 if number == 1 else [20.0]
        progress = [100.0] * len(laps) + [50.0] * (5 - len(laps))
        name = f"{number}_Step-{100 * number}.ckpt"
        write_evaluation(
            ModelStore(bucket, "model"), number, EvaluationResult(name, progress, [1.0] * 5, laps)
        )
        store.save(number + 1, 100 * number + 100, b"weights")
        curve = [iteration_record(n, world="short") for n in range(number)]
        write_history(ModelStore(bucket, "model"), [*curve, iteration_record(number, world=world)])

    scores = reconstruct_scores(ModelStore(bucket, "model"), "progress")

    assert scores is not None
    assert scores.best_checkpoint.name == best
