"""A model in a bucket: the handle by which everything of it is read and written."""

from collections.abc import Sequence
from dataclasses import dataclass

from drcli.bucket.bucket import Bucket
from drcli.config.run_config import ModelConfig
from drcli.model import keys


@dataclass(frozen=True)
class ModelStore:
    """Where a model is. Readers and writers of what it holds take this handle.

    Attributes:
        metrics_prefix: Empty: where metrics of a model usually are.
        workers: Numbers of those that write metrics.
    """

    bucket: Bucket
    prefix: str
    metrics_prefix: str = ""
    metric: str = "progress"
    workers: Sequence[int] = (0,)

    def __post_init__(self) -> None:
        if not self.metrics_prefix:
            object.__setattr__(self, "metrics_prefix", keys.metrics_prefix(self.prefix))

    @property
    def url(self) -> str:
        """As people and other programs write it."""
        return f"s3://{self.bucket.name}/{self.prefix}"

    @staticmethod
    def of(config: ModelConfig, bucket: Bucket, prefix: str) -> "ModelStore":
        """The model of a prefix; that of the settings has its places and workers."""
        if prefix != config.prefix:
            return ModelStore(bucket, prefix, metric=config.metric)
        workers = range(config.workers)
        return ModelStore(bucket, prefix, config.metrics_prefix, config.metric, workers)
