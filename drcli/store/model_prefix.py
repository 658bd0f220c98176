"""One model in a bucket: whether it exists, its newest checkpoint, and how to delete it."""

from collections.abc import Collection

from drcli.exchange.checkpoint import CheckpointName
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import checkpoint_objects


def is_used(bucket: Bucket, prefix: str) -> bool:
    """Whether there are objects below the prefix; `model-10` does not count for `model-1`.

    Nor do test objects, which `dr doctor` may be writing at the moment.
    """
    test = keys.folder(prefix) + keys.TEST_FOLDER
    return any(not item.key.startswith(test) for item in bucket.list(keys.folder(prefix)))


def newest_checkpoint(bucket: Bucket, prefix: str) -> CheckpointName | None:
    """The newest checkpoint, complete or not; None if there is none."""
    return max(checkpoint_objects(bucket, prefix).values(), default=None)


def contains(outer: str, inner: str) -> bool:
    """Whether deleting `outer` would delete `inner`, because it is the same or below it."""
    return keys.folder(inner).startswith(keys.folder(outer))


def wipe(bucket: Bucket, prefix: str, *, spared: Collection[str] = ()) -> None:
    """Delete the model, its rollouts and the records of its runs."""
    for folder in (keys.folder(prefix), keys.rollouts_folder(prefix), keys.run_folder(prefix)):
        bucket.delete([item.key for item in bucket.list(folder) if item.key not in spared])
