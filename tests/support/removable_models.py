"""Whole models in a bucket in memory, for tests of what deletes them."""

from drcli.model import keys
from memory_bucket import MemoryBucket

OTHERS = ("model-10", "model-1/inner", "model-1-old")


class Killed(Exception):
    """The process ends here."""


class MortalBucket(MemoryBucket):
    """Ends its user at a request to delete."""

    deletes_left = 1_000

    def delete(self, keys):
        if not self.deletes_left:
            raise Killed
        self.deletes_left -= 1
        super().delete(keys)


def put_all(bucket: MemoryBucket, prefix: str, *, iteration: int = 3) -> None:
    """Everything that a model can have."""
    names = (
        "model/0_Step-0.ckpt.safetensors model/0_Step-0.ckpt.json model/model_0.pb "
        "model/.coach_checkpoint model/milestones.json model/model_metadata.json ip/run.json "
        "ip/hyperparameters.json metrics/history.json notes/1.json journal/000001-a.jsonl "
        "logs/sagemaker/trainer.log training-simtrace/0-iteration.csv reward_function.py"
    )
    for name in names.split():
        bucket.put(keys.folder(prefix) + name, b"{}")
    name = b'{"name": "0_Step-0.ckpt"}'
    scores = b'{"best_checkpoint": %b, "last_checkpoint": %b}' % (name, name)
    bucket.put(keys.deepracer_checkpoints(prefix), scores)
    bucket.put(keys.rollout_manifest(prefix, iteration, 0), b"{}")
    bucket.put(keys.outcome(prefix), b"{}")
    bucket.put(keys.evaluation_result(prefix, 0), b"{}")
    bucket.put(keys.damaged(prefix, "x", "20260101000000"), b"?" * 100)


def put_checkpoints(bucket: MemoryBucket, last: int) -> None:
    """The checkpoints 1 to `last` of model-1."""
    for number in range(1, last + 1):
        name = f"{number}_Step-{number}.ckpt"
        bucket.put(keys.checkpoint_tensors("model-1", name), b"{}")
        bucket.put(keys.checkpoint_record("model-1", name), b"{}")
        bucket.put(keys.checkpoint_graph("model-1", number), b"graph")


def objects(bucket: MemoryBucket) -> set[str]:
    return {info.key for info in bucket.list("")}
