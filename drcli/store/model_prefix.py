"""What the bucket holds of one model: whether there is anything, how far it got, its removal."""

from collections.abc import Collection

from drcli.exchange.checkpoint import CheckpointName
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import checkpoint_objects


def is_used(bucket: Bucket, prefix: str) -> bool:
    """Whether anything lies below the prefix; a model whose name only starts alike is no matter."""
    return bool(bucket.list(keys.folder(prefix)))


def newest_checkpoint(bucket: Bucket, prefix: str) -> CheckpointName | None:
    """The checkpoint that counts furthest, whole or not; None where there is none."""
    return max(checkpoint_objects(bucket, prefix).values(), default=None)


def contains(outer: str, inner: str) -> bool:
    """Whether wiping one prefix would delete another, or what lies at both is one and the same."""
    return keys.folder(inner).startswith(keys.folder(outer))


def wipe(bucket: Bucket, prefix: str, *, spared: Collection[str] = ()) -> None:
    """Delete the model, its rollouts, and what was noted of its runs.

    Args:
        bucket: Holds it.
        prefix: Of the model.
        spared: Keys of objects that stay.
    """
    for folder in (keys.folder(prefix), keys.rollouts_folder(prefix), keys.run_folder(prefix)):
        bucket.delete([item.key for item in bucket.list(folder) if item.key not in spared])
