"""Finds weights of another model to start with, and checks them."""

from dataclasses import dataclass

from drcli.base.errors import Place, Problem, ProblemsError, SettingsError, refuse
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.config.fields import setting_problem
from drcli.config.run_config import PretrainedConfig
from drcli.config.value_types import CheckpointChoice
from drcli.convert.stored_checkpoint import load_checkpoint
from drcli.model import keys
from drcli.model.checkpoint_choice import (
    CheckpointGone,
    Chosen,
    ModelCheckpoints,
)
from drcli.model.checkpoints import Checkpoint, CheckpointStore
from drcli.model.files.network_shape import Design, weight_problems
from drcli.model.model_prefix import contains, what_helps
from drcli.model.model_store import ModelStore
from drcli.records.scores import Score
from drcli.records.training_record import Pretrained

PREFIX = "DR_LOCAL_S3_PRETRAINED_PREFIX"


@dataclass(frozen=True)
class Transfer:
    """Weights as safetensors; `sentence` says which; `critic_warmup` is as in `Counters`."""

    source: Pretrained
    sentence: str
    tensors: bytes
    warnings: list[Problem]
    critic_warmup: int | None = None


def find(
    config: PretrainedConfig, bucket: Bucket, new: str, wanted: Design | None, *, wiping: bool
) -> Transfer | None:
    """Read the weights that the DR_LOCAL_S3_PRETRAINED settings name; None without a design.

    Raises:
        ProblemsError: Model or checkpoint is missing, or does not fit.
    """
    prefix, place = config.prefix, config.place
    if wiping and contains(new, prefix):
        what = f"-w would delete that model, because it is inside DR_LOCAL_S3_MODEL_PREFIX={new}."
        remedy = "Choose another DR_LOCAL_S3_MODEL_PREFIX."
        raise _wrong(PREFIX, place, prefix, what, remedy)
    store = ModelStore(bucket, prefix)
    source, found, sentence = read_weights(store, config.checkpoint, PREFIX, place)
    if wanted is None:
        return None
    try:
        trained = Design.of_record(store, found.record)
    except ObjectMissing as e:
        remedy = "Restore that file from a copy, or choose another model."
        raise _wrong(PREFIX, place, prefix, f"that model is not complete: {e}", remedy) from e
    warnings = weight_problems(trained, wanted, store.url)
    refuse(warnings)
    if config.checkpoint == "best" and source.metric is None:
        name = "DR_LOCAL_S3_PRETRAINED_CHECKPOINT"
        what = (
            f"no checkpoint of {store.url} has been evaluated yet, so its first one, "
            f"{source.name}, counts as its best."
        )
        remedy = "Ignore this if you want that checkpoint."
        warnings.append(
            setting_problem(name, config.checkpoint_place, what, remedy, severity="warning")
        )
    return Transfer(source, sentence, found.tensors, warnings, found.record.counters.critic_warmup)


def read_weights(
    model: ModelStore, checkpoint: CheckpointChoice, name: str, place: Place
) -> tuple[Pretrained, Checkpoint, str]:
    """Read the setting's checkpoint, and say which one it is.

    Raises:
        ProblemsError: It is missing or incomplete.
    """
    folder = f"s3://{model.bucket.name}/{keys.model_folder(model.prefix)}"
    checkpoints = ModelCheckpoints.read(model)
    scores = checkpoints.scores
    try:
        pointed = CheckpointStore(model).pointed()
        if scores is None and pointed is not None:
            chosen = str(pointed)
        elif scores is None:
            remedy = what_helps(model, setting=name)
            raise _wrong(name, place, model.prefix, f"there is no checkpoint at {folder}.", remedy)
        else:
            chosen = checkpoints.choose(checkpoint).name
        found = load_checkpoint(model, chosen)
    except (ObjectMissing, ObjectDamaged, CheckpointGone) as e:
        what = str(e).removeprefix(f"{model.url}: ")  # the setting names the model
        if not isinstance(e, CheckpointGone):
            what = f"its {checkpoint} checkpoint cannot be used: {e} {checkpoints.summary}"
        other = "last" if checkpoint == "best" else "best"
        remedy = f"Set DR_LOCAL_S3_PRETRAINED_CHECKPOINT={other} or to another one of these, or "
        raise _wrong(name, place, model.prefix, what, f"{remedy}choose another model.") from e
    except ProblemsError:
        raise
    except SettingsError as e:  # a TensorFlow checkpoint of another network
        raise _wrong(name, place, model.prefix, str(e), e.remedy) from e
    metric = None if scores is None else scores.metric_of(chosen)
    sha256 = found.record.tensors.sha256
    sentence = checkpoints.sentence_about(Chosen(checkpoint, Score(chosen, metric), ()))
    return Pretrained(model.prefix, str(checkpoint), chosen, metric, sha256), found, sentence


def _wrong(name: str, place: Place, prefix: str, message: str, remedy: str) -> ProblemsError:
    return ProblemsError([setting_problem(name, place, f"{name}={prefix}: {message}", remedy)])
