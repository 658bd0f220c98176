"""Uploads that are cut short, that cross each other, or whose source is being trained."""

from collections.abc import Callable
from contextlib import suppress

import pytest

from drcli.base.errors import StorageError
from drcli.model import keys
from drcli.model.checkpoint_choice import CheckpointGone
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from memory_bucket import MemoryBucket

from .conftest import driven, put_model

TARGET = "team/model-1"
MOST_CALLS = 40


class CutError(Exception):
    """Raised in the place of a call that never arrives."""


class FragileBucket(MemoryBucket):
    """Lets the connection break before one of the next writes or deletions."""

    calls_left = 1_000

    def put(self, key, data, *, watch=None):
        self._count()
        super().put(key, data, watch=watch)

    def delete(self, doomed):
        self._count()
        super().delete(doomed)

    def _count(self):
        if not self.calls_left:
            raise CutError
        self.calls_left -= 1


class HookedBucket(MemoryBucket):
    """Lets something happen once, after the first object of some name was written."""

    def __init__(self, name: str, end: str, then: Callable[[], object]) -> None:
        super().__init__(name)
        self._end = end
        self._then: Callable[[], object] | None = then

    def put(self, key, data, *, watch=None):
        super().put(key, data, watch=watch)
        if key.endswith(self._end) and self._then is not None:
            then, self._then = self._then, None
            then()


@pytest.fixture
def fragile(mover):
    """A target with checkpoint 3."""
    mover.use(FragileBucket("uploads"))
    mover.upload(choice="best")
    return mover.there


def cut_after_each_call(fragile, make, look):
    """Break an upload after 0, 1, 2... calls, look at the target, and finish it."""
    for calls in range(MOST_CALLS):
        fragile.calls_left = calls
        try:
            make()
        except CutError:
            fragile.calls_left = 1_000
            look()
        else:
            return calls
    raise AssertionError("the upload never ended")


@pytest.mark.parametrize("wipe", [False, True])
def test_a_later_checkpoint_replaces_the_old_one_at_once(mover, fragile, wipe):
    seen = set()

    def look():
        seen.add(driven(fragile, TARGET))
        mover.upload(choice="best", wipe=True)

    calls = cut_after_each_call(fragile, lambda: mover.upload(wipe=wipe), look)

    assert calls > 4
    assert seen <= {"weights 3 of design a", "weights 5 of design a"}
    assert driven(fragile, TARGET) == "weights 5 of design a"


def test_a_model_of_another_design_is_whole_or_not_there(mover, fragile):
    put_model(mover.here, "other", design="b", numbers=(8,))
    seen = set()

    def look():
        seen.add(driven(fragile, TARGET))
        mover.upload(choice="best", wipe=True)

    cut_after_each_call(fragile, lambda: mover.upload(prefix="other", to=TARGET), look)

    assert seen <= {"weights 3 of design a", None, "weights 8 of design b"}
    assert driven(fragile, TARGET) == "weights 8 of design b"


def test_other_weights_under_the_same_name_are_whole_or_not_there(mover, fragile):
    put_model(mover.here, "again", design="b", numbers=(3,))
    seen = set()

    def look():
        seen.add(driven(fragile, TARGET))
        mover.upload(choice="best", wipe=True)

    cut_after_each_call(fragile, lambda: mover.upload(prefix="again", to=TARGET), look)

    assert seen <= {"weights 3 of design a", None, "weights 3 of design b"}
    assert driven(fragile, TARGET) == "weights 3 of design b"


def test_an_upload_that_was_cut_short_sends_only_what_is_missing(mover, fragile):
    fragile.calls_left = 4  # a test object is written and deleted first
    with pytest.raises(CutError):
        mover.upload()
    fragile.calls_left = 1_000

    report = mover.upload()

    assert report.unchanged[:2] == [
        "model/5_Step-500.ckpt.safetensors",
        "model/5_Step-500.ckpt.optimizer.safetensors",
    ]
    assert report.copied[0] == "model/5_Step-500.ckpt.json"


@pytest.mark.parametrize(
    "end", ["5_Step-500.ckpt.safetensors", "training_params.yaml", ".coach_checkpoint", "ts.json"]
)
@pytest.mark.parametrize("wipe", [False, True])
def test_two_uploads_that_cross_leave_one_whole_model(mover, end, wipe):
    mover.use(HookedBucket("uploads", end, lambda: mover.upload(choice="best", wipe=wipe)))

    mover.upload(wipe=wipe)

    pointer = mover.there.get(keys.coach_checkpoint(TARGET)).decode()
    assert driven(mover.there, TARGET) in ("weights 3 of design a", "weights 5 of design a")
    assert pointer == CheckpointStore(ModelStore(mover.there, TARGET)).best_name()


EVERY_STEP = [
    "ckpt.safetensors",
    "ckpt.json",
    "hyperparameters.json",
    "model/model_metadata.json",
    "training_params.yaml",
    ".coach_checkpoint",
    "deepracer_checkpoints.json",
]


@pytest.mark.parametrize("end", EVERY_STEP)
def test_uploads_of_two_designs_that_cross_leave_no_mixture(mover, end):
    put_model(mover.here, "other", design="b", numbers=(8,))
    mover.use(HookedBucket("uploads", end, lambda: mover.upload(prefix="other", to=TARGET)))

    with suppress(StorageError):
        mover.upload()

    assert driven(mover.there, TARGET) in ("weights 5 of design a", "weights 8 of design b", None)


@pytest.mark.parametrize("end", EVERY_STEP)
def test_downloads_of_two_designs_that_cross_leave_no_mixture(mover, end):
    put_model(mover.there, "first")
    put_model(mover.there, "second", design="b", numbers=(8,))
    mover.use_as_source()
    mover.here = HookedBucket(
        "bucket", end, lambda: mover.download("s3://uploads/second", "mine", wipe=True)
    )

    with suppress(StorageError):
        mover.download("s3://uploads/first", "mine")

    assert driven(mover.here, "mine") in ("weights 3 of design a", "weights 8 of design b", None)


def test_an_index_that_names_deleted_files_is_written_again(mover):
    def claim():
        mover.there.put(
            keys.deepracer_checkpoints(TARGET),
            mover.here.get(keys.deepracer_checkpoints("team/model")).replace(b"5_S", b"9_S"),
        )

    mover.use(HookedBucket("uploads", "ts.json", claim))

    mover.upload()

    assert driven(mover.there, TARGET) == "weights 5 of design a"


def test_a_server_that_alters_what_it_is_given_is_found_out(mover):
    class LyingBucket(MemoryBucket):
        def put(self, key, data, *, watch=None):
            altered = data[:-1] + b"?" if key.endswith("ckpt.safetensors") else data
            super().put(key, altered, watch=watch)

    mover.use(LyingBucket("uploads"))

    with pytest.raises(StorageError, match=r"wrongly \d+ times"):
        mover.upload()

    assert driven(mover.there, TARGET) is None


def test_an_object_that_arrives_altered_once_is_sent_again(mover):
    def damage():
        mover.there.put(f"{TARGET}/model/5_Step-500.ckpt.safetensors", b"?")

    mover.use(HookedBucket("uploads", "500.ckpt.safetensors", damage))

    mover.upload()

    assert driven(mover.there, TARGET) == "weights 5 of design a"


class TrainingBucket(MemoryBucket):
    """Goes on training while it is read: the pointer moves on and old weights are pruned."""

    def __init__(self, steps: int) -> None:
        super().__init__("bucket")
        self._left = steps

    def get(self, key, *, watch=None):
        if key.endswith("ckpt.json") and "/model/" in key and self._left:
            left, self._left = self._left - 1, 0
            last = CheckpointName.parse(key.split("/")[-1].removesuffix(".json"))
            assert last is not None
            for step in range(1, 6):
                put_model(self, "team/model", numbers=(last.number + step,))
            self._left = left
        return super().get(key, watch=watch)


@pytest.fixture
def training(mover):
    def start(steps: int) -> None:
        mover.here = TrainingBucket(0)
        put_model(mover.here, "team/model", numbers=(5,))
        mover.here._left = steps

    return start


def test_another_checkpoint_is_chosen_if_the_first_is_deleted_meanwhile(mover, training):
    training(3)  # the first is gone before a checkpoint is chosen

    report = mover.upload()

    chosen = CheckpointName.parse(report.checkpoint)
    assert chosen is not None
    assert chosen.number > 5
    assert driven(mover.there, TARGET) == f"weights {chosen.number} of design a"


def test_a_numbered_checkpoint_that_is_pruned_under_way_is_given_up(mover, training):
    training(2)

    with pytest.raises(CheckpointGone, match="Checkpoint 5 was deleted"):
        mover.upload(choice=5)


def test_a_training_that_never_lets_a_checkpoint_be_read_is_given_up(mover, training):
    training(1_000)

    with pytest.raises(CheckpointGone, match="does not exist"):
        mover.upload()
