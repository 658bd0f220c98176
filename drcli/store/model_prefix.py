"""One model in a bucket: exists, newest checkpoint, deletion."""

from collections.abc import Collection

from drcli.exchange.checkpoint import CheckpointName
from drcli.store import keys
from drcli.store.bucket import TEST_FOLDER, Bucket
from drcli.store.checkpoints import checkpoint_objects


def is_used(bucket: Bucket, prefix: str) -> bool:
    """Whether there are objects below the prefix; `model-10` does not count for `model-1`.

    Nor do test objects, which `dr doctor` may be writing at the moment.
    """
    test = keys.folder(prefix) + TEST_FOLDER
    return any(not item.key.startswith(test) for item in bucket.list(keys.folder(prefix)))


def newest_checkpoint(bucket: Bucket, prefix: str) -> CheckpointName | None:
    return max(checkpoint_objects(bucket, prefix).values(), default=None)


def delete_unlearned(bucket: Bucket, prefix: str) -> None:
    """Workers that drive ahead of a trainer that ended leave such an iteration."""
    newest = newest_checkpoint(bucket, prefix)
    if newest is None:
        return
    ahead = []
    for info in bucket.list(keys.rollouts_folder(prefix)):
        key = keys.rollout_key(prefix, info.key)
        if key is not None and key.iteration >= newest.number:
            ahead.append(info.key)
    bucket.delete(ahead)


def contains(outer: str, inner: str) -> bool:
    return keys.folder(inner).startswith(keys.folder(outer))


def wipe(bucket: Bucket, prefix: str, *, spared: Collection[str] = ()) -> None:
    for folder in (keys.folder(prefix), keys.rollouts_folder(prefix), keys.run_folder(prefix)):
        bucket.delete([item.key for item in bucket.list(folder) if item.key not in spared])


def has_checkpoint(bucket: Bucket, prefix: str) -> bool:
    """Ours or TensorFlow's, maybe damaged."""
    ends = (".ckpt.json", ".ckpt.index")
    return any(key.endswith(ends) for key in checkpoint_objects(bucket, prefix))


def is_aborted_start(bucket: Bucket, prefix: str, parameter_files: Collection[str]) -> bool:
    """Whether there is only what a start wrote before its checkpoint.

    A new start may overwrite that.
    """
    known = {
        keys.reward_function(prefix),
        keys.model_metadata(prefix),
        keys.hyperparameters(prefix),
        keys.training_start(prefix),
        keys.curriculum(prefix),
        *(keys.parameter_file(prefix, name) for name in parameter_files),
    }
    folders = (
        f"{keys.folder(prefix)}logs/",
        keys.event_folder(prefix),
        keys.journal_folder(prefix),
        keys.notes_folder(prefix),
    )
    unfinished = checkpoint_objects(bucket, prefix)
    if any(
        name.number or key.endswith(".ckpt.json") or keys.is_tensorflow_part(key)
        for key, name in unfinished.items()
    ):
        return False
    listed = {info.key for info in bucket.list(keys.folder(prefix))}
    ours = keys.training_start(prefix) in listed or bucket.exists(keys.outcome(prefix))
    return ours and all(
        key in known or key in unfinished or key.startswith(folders) for key in listed
    )
