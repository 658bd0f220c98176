"""Continues a TensorFlow checkpoint, which becomes one of ours beside it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from drcli.bucket.bucket import ObjectDamaged
from drcli.convert.stored_checkpoint import load_checkpoint
from drcli.model.best_checkpoint import read_scores, write_scores
from drcli.model.checkpoint_choice import missing_parts
from drcli.model.checkpoints import Checkpoint, CheckpointStore
from drcli.model.files.custom_files import InputFile
from drcli.model.files.network_shape import model_files
from drcli.model.model_prefix import ModelListing, is_tensorflow
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from drcli.records.scores import Score, Scores


@dataclass(frozen=True)
class Conversion:
    """The newest TensorFlow checkpoint as one of ours; nothing is written yet."""

    model: ModelStore
    checkpoint: Checkpoint
    best: str | None

    @property
    def name(self) -> str:
        return self.checkpoint.record.name

    def own_files(self, files: Mapping[str, InputFile]) -> dict[str, InputFile]:
        """Corrected by the policy: the reference ignores some values, such as `stack_size`."""
        fitted = self.checkpoint.record.counters.inputs
        return {
            name: replace(files[name], data=fitted[name].encode())
            for name, key in model_files(self.model.prefix).items()
            if name in files and files[name].origin == f"{self.model.bucket.name}/{key}"
        }

    @property
    def sentence(self) -> str:
        best = ""
        if self.best is not None:
            best = (
                f" The best one so far, {self.best}, was judged in another simulation: the next "
                "checkpoint that is evaluated becomes the best."
            )
        return (
            f"{self.name} is a TensorFlow checkpoint. The training continues from its weights, "
            f"with a fresh optimizer; its files stay where they are.{best}"
        )

    def write(self) -> None:
        record = self.checkpoint.record
        CheckpointStore(self.model).save(
            record.number, record.steps, self.checkpoint.tensors, counters=record.counters
        )
        last = Score(record.name)
        write_scores(self.model, Scores(last, last))


def plan_conversion(listed: ModelListing) -> Conversion | None:
    """Read the newest checkpoint if it is TensorFlow's, else None.

    The pointer names it or, if that is incomplete, it has the highest number, as in the reference.

    Raises:
        DrError: It cannot be read or trained here.
    """
    if not listed.has_tensorflow:
        return None
    model, objects = listed.model, listed.objects
    names, infos = set(listed.checkpoints.values()), objects.values()
    whole = {name for name in names if not missing_parts(infos, model.prefix, str(name))}
    pointed = CheckpointStore(model).pointed()
    newest: CheckpointName | None = pointed if pointed in whole else max(whole, default=None)
    if newest is None or not is_tensorflow(objects, model.prefix, str(newest)):
        return None
    try:
        scores = read_scores(model)
    except ObjectDamaged:
        scores = None
    best = None if scores is None else scores.best_checkpoint.name
    found = load_checkpoint(model, str(newest))
    return Conversion(model, found, None if best == str(newest) else best)
