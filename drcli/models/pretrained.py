"""Starts a model with the weights of another one: finds them, checks them, hands them over."""

from dataclasses import dataclass
from typing import Literal

from drcli.base.errors import SettingsError
from drcli.config.run_config import PretrainedConfig
from drcli.modelfiles.network_shape import Design, refuse_misfit
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.checkpoint_record import Record
from drcli.store.checkpoints import CheckpointStore
from drcli.store.model_prefix import contains
from drcli.store.repair import Model, readable_scores


@dataclass(frozen=True)
class Pretrained:
    """Weights to start from.

    Attributes:
        prefix: The model they are from.
        checkpoint: Which of its checkpoints: last or best.
        name: That checkpoint, such as `12_Step-7824.ckpt`.
        metric: How it was evaluated there, None where it was not.
        sha256: Fingerprint of the weights.
    """

    prefix: str
    checkpoint: Literal["last", "best"]
    name: str
    metric: float | None
    sha256: str


@dataclass(frozen=True)
class Transfer:
    """Everything a start from another model's weights needs, read and checked.

    Attributes:
        tensors: The weights, a safetensors file.
        warnings: Sentences about what is allowed and may surprise.
    """

    source: Pretrained
    tensors: bytes
    warnings: list[str]

    def hand_over(self, bucket: Bucket, prefix: str) -> Record:
        """Make the weights checkpoint 0 of a new model, which its trainer goes on from.

        Steps, episodes and time count from 0 and the optimizer starts afresh.
        """
        counters = {"episodes": 0, "elapsed_s": 0.0}
        return CheckpointStore(bucket, prefix).save(0, 0, self.tensors, counters=counters)


def find(
    config: PretrainedConfig, bucket: Bucket, new: str, wanted: Design, *, wiping: bool
) -> Transfer:
    """Read the weights that the DR_LOCAL_S3_PRETRAINED settings name, and check that they fit.

    Args:
        config: Names the model that has the weights.
        bucket: Holds both models.
        new: Prefix of the new model.
        wanted: The new model's own design.
        wiping: Whether what lies under the new model's prefix is going to be deleted.

    Raises:
        SettingsError: There is no such model, it has no whole checkpoint, or it does not fit.
    """
    prefix, written = config.prefix, config.written
    if wiping and contains(new, prefix):
        raise SettingsError(
            f"{written}: -w would delete that model, because it lies below "
            f"DR_LOCAL_S3_MODEL_PREFIX={new}.",
            remedy="Choose a DR_LOCAL_S3_MODEL_PREFIX beside it.",
        )
    source, tensors = read_weights(bucket, prefix, config.checkpoint, written)
    try:
        trained = Design.of_model(bucket, prefix)
    except ObjectMissing as e:
        raise SettingsError(
            f"{written}: that model is not complete: {e}",
            remedy="Restore that file from a copy, or name another model.",
        ) from e
    model = f"s3://{bucket.name}/{prefix}"
    warnings = refuse_misfit(trained, wanted, model)
    if config.checkpoint == "best" and source.metric is None:
        warnings.append(
            f"{config.checkpoint_source}: no checkpoint of {model} was "
            f"evaluated yet, so {source.name} only counts as its best for being the first."
        )
    return Transfer(source, tensors, warnings)


def read_weights(
    bucket: Bucket, prefix: str, checkpoint: Literal["last", "best"], written: str
) -> tuple[Pretrained, bytes]:
    """The weights of a model's last or best checkpoint, whole.

    Raises:
        SettingsError: There are none; the sentence says what is missing.
    """
    folder = f"s3://{bucket.name}/{keys.model_folder(prefix)}"
    remedy = "Correct the prefix, or train that model first."
    store = CheckpointStore(bucket, prefix)
    try:
        scores, _ = readable_scores(Model(bucket, prefix, keys.metrics_prefix(prefix)))
        pointed = store.pointed()
        name = None if pointed is None else str(pointed)
        if scores is not None:
            last = name or scores.last_checkpoint.name
            name = scores.best_checkpoint.name if checkpoint == "best" else last
        if name is None:
            raise SettingsError(f"{written}: there is no checkpoint at {folder}.", remedy=remedy)
        found = store.load(name)
    except (ObjectMissing, ObjectDamaged) as e:
        if any(item.key.endswith(".ckpt.index") for item in bucket.list(keys.model_folder(prefix))):
            raise SettingsError(
                f"{written}: the checkpoints at {folder} are TensorFlow's, whose weights cannot "
                "be read here.",
                remedy="Name a model that was trained here, or start with fresh weights.",
            ) from e
        other = "last" if checkpoint == "best" else "best"
        raise SettingsError(
            f"{written}: its {checkpoint} checkpoint cannot be used: {e}",
            remedy=f"Set DR_LOCAL_S3_PRETRAINED_CHECKPOINT={other}, or name another model.",
        ) from e
    metric = None if scores is None else scores.metric_of(name)
    sha256 = found.record.tensors.sha256
    return Pretrained(prefix, checkpoint, name, metric, sha256), found.tensors
