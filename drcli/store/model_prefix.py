"""One model in a bucket: whether it exists, its newest checkpoint, and how to delete it."""

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
    """The newest checkpoint, complete or not; None if there is none."""
    return max(checkpoint_objects(bucket, prefix).values(), default=None)


def delete_unlearned(bucket: Bucket, prefix: str) -> None:
    """Delete rollouts that nobody learns from any more, when a training is complete.

    Workers that drive ahead of the trainer leave one such iteration.
    """
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
    """Whether deleting `outer` would delete `inner`, because it is the same or below it."""
    return keys.folder(inner).startswith(keys.folder(outer))


def wipe(bucket: Bucket, prefix: str, *, spared: Collection[str] = ()) -> None:
    """Delete the model, its rollouts and the records of its runs."""
    for folder in (keys.folder(prefix), keys.rollouts_folder(prefix), keys.run_folder(prefix)):
        bucket.delete([item.key for item in bucket.list(folder) if item.key not in spared])


def has_checkpoint(bucket: Bucket, prefix: str) -> bool:
    """Whether there is a checkpoint, ours or TensorFlow's, written to its end, damaged or not."""
    ends = (".ckpt.json", ".ckpt.index")
    return any(key.endswith(ends) for key in checkpoint_objects(bucket, prefix))


def is_aborted_start(bucket: Bucket, prefix: str, parameter_files: Collection[str]) -> bool:
    """Whether the prefix holds nothing but what a start wrote that ended before its checkpoint.

    Then nothing is lost if a new start writes these objects again.

    Args:
        bucket: Of the model.
        prefix: The model.
        parameter_files: Names of the parameter files that a start writes.
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
