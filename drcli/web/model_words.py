"""What a model does now and how its training went, as labels and as sentences of the page."""

import re
from collections.abc import Iterator
from datetime import datetime

from drcli.base.clock import duration
from drcli.base.report import size_text
from drcli.model.checkpoint_list import ListedCheckpoint
from drcli.model.model_list import ModelEntry
from drcli.transfer.training_list import TrainingEntry
from drcli.web.evaluation_words import lap_text
from drcli.web.page_words import in_page

Badge = tuple[str, str, str]
"""Kind, which is good, bad or empty; text; what it means."""

_BROKEN = {"failed": "training failed", "lost": "training broke off"}
_ENDED = {
    "finished": "It has finished its training",
    "stopped": "It was stopped",
    "interrupted": "It was interrupted",
    "failed": "Its training failed",
    "lost": "Its training ended without saying why",
}


def badges_of(
    model: ModelEntry | None,
    training: TrainingEntry | None,
    *,
    trains: bool,
    evaluated: bool,
    current: bool,
) -> Iterator[Badge]:
    """`current`: the settings name it."""
    if trains:
        yield "good", "training now", ""
    elif training is not None and training.state in _BROKEN:
        yield "bad", _BROKEN[training.state], in_page(training.message)
    if evaluated:
        yield "good", "evaluated now", ""
    if current:
        yield "", "in run.env", "DR_LOCAL_S3_MODEL_PREFIX in run.env"
    if model is not None and model.kind == "tensorflow":
        yield "", "TensorFlow", "Trained with DeepRacer-for-Cloud or a console"
    if model is not None and model.damaged:
        yield "bad", "damaged", in_page(" ".join(model.damaged))


ACTIONS = {
    "clone": "Clone",
    "submit": "Submit to a race",
    "download": "Download",
    "upload": "Upload",
    "delete": "Delete",
}
"""What can always be done with a model."""

CHECKPOINT_ACTIONS = {
    "evaluate": "Evaluate",
    "clone": "Clone",
    "submit": "Submit",
    "download": "Download",
}


def figures_of(
    model: ModelEntry | None, training: TrainingEntry | None
) -> list[tuple[str, str | None]]:
    """Of what is there; None for what is not known."""
    found: list[tuple[str, str | None]] = []
    if training is not None:
        found += [
            ("Best clean lap", lap_text(training.best_lap_s)),
            ("Iterations", f"{training.iterations:,}"),
            ("Training time", duration(training.elapsed_s)),
        ]
    if model is not None:
        best, last = (None if each is None else each.text for each in (model.best, model.last))
        found[1:1] = [("Best checkpoint", best), ("Last checkpoint", last)]
        found.append(("Size", size_text(model.size_bytes)))
    return found


def story_of(training: TrainingEntry | None, *, trains: bool) -> str:
    """Where and how it was trained, and how that ended."""
    if training is None:
        return "There is no record of its training."
    kind = training.race_type.lower().replace("_", " ")
    space = re.sub(r"^discrete, (\d+)$", r"discrete, \1 actions", training.action_space or "")
    facts = ", ".join(filter(None, (training.world, kind, training.algorithm, space)))
    said = facts or "Track and algorithm of its training are not recorded"
    if trains:
        return f"{said}. It is being trained."
    ended = _ENDED.get(training.state, "")
    if ended and training.ended_at:
        at = datetime.fromisoformat(training.ended_at).astimezone()
        ended += f" ({at:%d %b %Y, %H:%M})"
    # Why it failed is shown with what mends it.
    message = "" if training.state == "failed" else in_page(training.message)
    return " ".join(filter(None, (f"{said}.", ended and f"{ended}.", message)))


_MARKS = {
    "last": "the newest",
    "best": "the best",
    "first-lap": "of the first lap",
    "three-laps": "of three laps in one evaluation",
    "best-lap": "of the best lap",
}


def marks_of(checkpoint: ListedCheckpoint) -> Iterator[tuple[str, str]]:
    """A text, and what it means."""
    for word in checkpoint.words:
        yield word, f"Checkpoint {_MARKS.get(word, word)}"
    if checkpoint.untaught:
        yield "untaught", "Until there, only the teacher has learned"
    if checkpoint.every:
        yield "kept every n", "DR_TRAIN_KEEP_EVERY"
    if checkpoint.form == "tensorflow":
        yield "TensorFlow", "Of DeepRacer-for-Cloud or a console"
