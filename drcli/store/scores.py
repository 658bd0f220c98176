"""The best and the last checkpoint of a model: `deepracer_checkpoints.json`."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from drcli.base.json_record import Misfit, built
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, get_json
from drcli.store.keys import CheckpointName

UNFINISHED_MS = 999_999.0
"""Lap time of an unfinished lap, milliseconds. Source: the reference simulator."""

_TIE_BREAK = "best_tie_break"


@dataclass(frozen=True)
class Score:
    """How well a checkpoint drives.

    Args:
        name: Checkpoint.
        avg_eval_metric: Mean of its evaluation episodes, None before it was evaluated.
        time_stamp: Simulated seconds when the checkpoint was made.
        tie_break: What decides between equal means, the lower the better; None where unknown.
    """

    name: str
    avg_eval_metric: float | None
    time_stamp: float
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

    def with_evaluation(self, score: Score, *, lower_is_better: bool) -> "Scores":
        """The scores once a checkpoint was evaluated.

        Equal means are told apart by their tie-breaks; what is equal in both, or has no tie-break
        to compare, goes to the one evaluated later.
        """
        best, last = self.best_checkpoint, self.last_checkpoint
        is_best = score.name == best.name or _beats(score, best, lower_is_better)
        return replace(
            self,
            best_checkpoint=score if is_best else best,
            last_checkpoint=score if score.name == last.name else last,
        )


def read_scores(bucket: Bucket, prefix: str) -> Scores | None:
    """The scores of a model, None before its first checkpoint.

    Raises:
        ObjectDamaged: The file is unreadable.
    """
    key = keys.deepracer_checkpoints(prefix)
    try:
        return scores_of(get_json(bucket, key))
    except ObjectMissing:
        return None
    except Misfit as e:
        raise ObjectDamaged(
            f"{bucket.name}/{key} is damaged: {e}.",
            remedy="Go on with `dr-start-training --resume`, which rebuilds it.",
        ) from e


def scores_of(file: Any) -> Scores:
    """The scores from the JSON of their file.

    Raises:
        Misfit: They do not name a best and a last checkpoint.
    """
    entries = built(_File, file)
    best, last = _score(entries.best_checkpoint), _score(entries.last_checkpoint)
    return Scores(replace(best, tie_break=entries.best_tie_break), last)


def write_scores(bucket: Bucket, prefix: str, scores: Scores) -> None:
    """Write the scores on one line."""
    bucket.put(keys.deepracer_checkpoints(prefix), scores_file(scores))


def scores_file(scores: Scores) -> bytes:
    """The file of the scores."""
    written = asdict(scores)
    for entry in written.values():
        entry.pop("tie_break")
    if scores.best_checkpoint.tie_break is not None:
        written[_TIE_BREAK] = scores.best_checkpoint.tie_break
    return json.dumps(written, allow_nan=False).encode()


def single_score(score: Score) -> bytes:
    """The file of a model with one checkpoint alone, as after an upload: the last one first.

    Older tools know the metric as `avg_comp_pct`, and -1 as its value before an evaluation.
    """
    entry = asdict(score)
    del entry["tie_break"]
    metric = score.avg_eval_metric
    entry["avg_comp_pct"] = -1.0 if metric is None else metric
    written: dict[str, Any] = {"last_checkpoint": entry, "best_checkpoint": entry}
    if score.tie_break is not None:
        written[_TIE_BREAK] = score.tie_break
    return json.dumps(written, allow_nan=False).encode()


def metric_of(metric: str, result: Mapping[str, Sequence[float]]) -> float:
    """What DR_TRAIN_BEST_MODEL_METRIC makes of an evaluation: percent, reward or milliseconds."""
    values: Sequence[float] = result.get(metric, ())
    if metric == "laptime":
        unfinished = len(result["progress"]) - len(result["lap_s"])
        values = [1000.0 * lap_s for lap_s in result["lap_s"]] + [UNFINISHED_MS] * unfinished
    return sum(values) / len(values)


def tie_break_of(metric: str, progress: Sequence[float], lap_s: Sequence[float]) -> float:
    """What decides between checkpoints whose means are equal, the lower the better.

    That is the lap time for progress and reward, and the progress for lap times.

    Args:
        metric: DR_TRAIN_BEST_MODEL_METRIC: progress, reward or laptime.
        progress: Percent that each evaluation episode completed.
        lap_s: Duration of each of them that completed its lap, seconds.
    """
    if metric == "laptime":
        return -sum(progress) / max(1, len(progress))
    unfinished = len(progress) - len(lap_s)
    return (1000.0 * sum(lap_s) + UNFINISHED_MS * unfinished) / max(1, len(progress))


@dataclass(frozen=True)
class _Entry:
    """A checkpoint in the file; older tools leave out what they do not know."""

    name: str
    avg_eval_metric: float | None = None
    time_stamp: float = 0.0


@dataclass(frozen=True)
class _File:
    best_checkpoint: _Entry
    last_checkpoint: _Entry
    best_tie_break: float | None = None


def _score(entry: _Entry) -> Score:
    if CheckpointName.parse(entry.name) is None:
        raise Misfit(f"{json.dumps(entry.name)[:60]} is not the name of a checkpoint")
    return Score(entry.name, entry.avg_eval_metric, entry.time_stamp)


def _beats(score: Score, best: Score, lower_is_better: bool) -> bool:
    if best.avg_eval_metric is None:
        return True
    if score.avg_eval_metric is None:
        return False
    if score.avg_eval_metric == best.avg_eval_metric:
        if score.tie_break is None or best.tie_break is None:
            return True
        return score.tie_break <= best.tie_break
    return (score.avg_eval_metric < best.avg_eval_metric) == lower_is_better
