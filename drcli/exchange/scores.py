"""The best and the last checkpoint of a model: the file `deepracer_checkpoints.json`."""

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

from drcli.base.json_record import built, parsed
from drcli.exchange.checkpoint import checkpoint_name

_TIE_BREAK = "best_tie_break"


@dataclass(frozen=True)
class Score:
    """How well a checkpoint drives; older tools leave out what they do not know.

    Attributes:
        name: Checkpoint.
        avg_eval_metric: Mean of its evaluation episodes, None before it was evaluated.
        time_stamp: Simulated seconds when the checkpoint was made.
        tie_break: What decides between equal means, the lower the better; None where unknown.
    """

    name: str
    avg_eval_metric: float | None = None
    time_stamp: float = 0.0
    tie_break: float | None = None


@dataclass(frozen=True)
class Scores:
    """The best checkpoint and the newest one, which is not evaluated yet when it is new.

    Field names are those of the file, which upload and evaluation tools read. Some of them split
    its text instead of reading JSON, so what is ours alone, the tie-break of the best, follows
    after everything they know.
    """

    best_checkpoint: Score
    last_checkpoint: Score

    def metric_of(self, name: str) -> float | None:
        """The evaluation of a checkpoint where it is still known."""
        known = (self.best_checkpoint, self.last_checkpoint)
        return next((score.avg_eval_metric for score in known if score.name == name), None)

    def encode(self) -> bytes:
        """The file, on one line."""
        entries = {"best_checkpoint": self.best_checkpoint, "last_checkpoint": self.last_checkpoint}
        return _file({key: _entry(score) for key, score in entries.items()}, self.best_checkpoint)

    @staticmethod
    def decode(data: bytes) -> "Scores":
        """The scores from their file.

        Raises:
            Misfit: They do not name a best and a last checkpoint.
        """
        file = parsed(data)
        scores = built(Scores, file)
        for score in (scores.best_checkpoint, scores.last_checkpoint):
            checkpoint_name(score.name)
        tie_break = built(_Own, file).best_tie_break
        return replace(scores, best_checkpoint=replace(scores.best_checkpoint, tie_break=tie_break))


def encode_single(score: Score) -> bytes:
    """The file of a model with one checkpoint alone, as after an upload: the last one first.

    Older tools know the metric as `avg_comp_pct`, and -1 as its value before an evaluation.
    """
    entry = _entry(score)
    entry["avg_comp_pct"] = -1.0 if score.avg_eval_metric is None else score.avg_eval_metric
    return _file({"last_checkpoint": entry, "best_checkpoint": entry}, score)


@dataclass(frozen=True)
class _Own:
    """What the file holds that the reference does not know."""

    best_tie_break: float | None = None


def _entry(score: Score) -> dict[str, Any]:
    entry = asdict(score)
    del entry["tie_break"]
    return entry


def _file(entries: dict[str, Any], best: Score) -> bytes:
    own = {} if best.tie_break is None else {_TIE_BREAK: best.tie_break}
    return json.dumps({**entries, **own}, allow_nan=False).encode()
