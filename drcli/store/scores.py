"""The best and the last checkpoint of a model: `deepracer_checkpoints.json`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, get_json, put_json


@dataclass(frozen=True)
class Score:
    """How well a checkpoint drives.

    Args:
        name: Checkpoint.
        avg_eval_metric: Mean of its evaluation episodes, None before it was evaluated.
        time_stamp: Simulated seconds when the checkpoint was made.
    """

    name: str
    avg_eval_metric: float | None
    time_stamp: float


@dataclass(frozen=True)
class Scores:
    """The best checkpoint and the newest one, which is not evaluated yet when it is new.

    Field names are those of the file, which upload and evaluation tools read.
    """

    best_checkpoint: Score
    last_checkpoint: Score

    def metric_of(self, name: str) -> float | None:
        """The evaluation of a checkpoint where it is still known."""
        known = (self.best_checkpoint, self.last_checkpoint)
        return next((score.avg_eval_metric for score in known if score.name == name), None)

    def with_evaluation(self, score: Score, *, lower_is_better: bool) -> "Scores":
        """The scores once a checkpoint was evaluated; a tie goes to the newer one."""
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
        found = get_json(bucket, key)
        return Scores(_score(found["best_checkpoint"]), _score(found["last_checkpoint"]))
    except ObjectMissing:
        return None
    except (AttributeError, KeyError, TypeError) as e:
        raise ObjectDamaged(
            f"{bucket.name}/{key} does not name a best and a last checkpoint: {e!r}.",
            remedy="Delete it; the next checkpoint writes it anew.",
        ) from e


def write_scores(bucket: Bucket, prefix: str, scores: Scores) -> None:
    """Write the scores on one line."""
    put_json(bucket, keys.deepracer_checkpoints(prefix), asdict(scores))


def _score(item: Mapping[str, Any]) -> Score:
    return Score(item["name"], item.get("avg_eval_metric"), item.get("time_stamp", 0.0))


def _beats(score: Score, best: Score, lower_is_better: bool) -> bool:
    if best.avg_eval_metric is None:
        return True
    if score.avg_eval_metric is None:
        return False
    if lower_is_better:
        return score.avg_eval_metric <= best.avg_eval_metric
    return score.avg_eval_metric >= best.avg_eval_metric
