"""Which checkpoint is the best: what an evaluation is worth, what beats what, where it is kept.

Worker 0 writes an evaluation result for a checkpoint, the trainer compares it with the best one so
far (`drcli.workers.scoring`) and keeps best and last in `deepracer_checkpoints.json`.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

from drcli.exchange.scores import EvaluationResult, Score, Scores
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing, read_record

UNFINISHED_MS = 999_999.0
"""Lap time of an unfinished lap, milliseconds. Source: the reference simulator."""


def metric_of(metric: str, result: EvaluationResult) -> float:
    """What DR_TRAIN_BEST_MODEL_METRIC makes of an evaluation: percent, reward or milliseconds."""
    if metric == "laptime":
        return _mean_lap_ms(result)
    return _mean(result.reward if metric == "reward" else result.progress)


def tie_break_of(metric: str, result: EvaluationResult) -> float:
    """What decides between checkpoints whose means are equal, the lower the better.

    That is the lap time for progress and reward, and the progress for lap times.
    """
    return -_mean(result.progress) if metric == "laptime" else _mean_lap_ms(result)


def score_of(result: EvaluationResult, metric: str, time_stamp: float) -> Score:
    """The score of a checkpoint that was made at some simulated time, seconds."""
    tie_break = tie_break_of(metric, result)
    return Score(result.checkpoint, metric_of(metric, result), time_stamp, tie_break)


def with_evaluation(scores: Scores, score: Score, metric: str) -> Scores:
    """The scores once a checkpoint was evaluated.

    Anything beats a checkpoint that was never evaluated. Equal means are told apart by their
    tie-breaks; what is equal in both, or has no tie-break, goes to the one evaluated later.
    """
    best, last = scores.best_checkpoint, scores.last_checkpoint
    is_best = score.name == best.name or _beats(score, best, lower_is_better=metric == "laptime")
    return Scores(
        best_checkpoint=score if is_best else best,
        last_checkpoint=score if score.name == last.name else last,
    )


def with_newest(scores: Scores | None, name: str, sim_time_s: float) -> Scores:
    """The scores once a checkpoint is the newest: the best one stays the best."""
    metric = None if scores is None else scores.metric_of(name)
    last = Score(name, metric, sim_time_s)
    return Scores(last if scores is None else scores.best_checkpoint, last)


def without_best(scores: Scores) -> Scores:
    """The scores where the best checkpoint is lost: the last stands for it until an evaluation."""
    last = replace(scores.last_checkpoint, avg_eval_metric=None)
    return Scores(last, last)


def without_metrics(scores: Scores) -> Scores:
    """The best checkpoint stays, but not how good it was: the next evaluation beats it."""
    best = replace(scores.best_checkpoint, avg_eval_metric=None, tie_break=None)
    return Scores(best, replace(scores.last_checkpoint, avg_eval_metric=None))


def read_scores(bucket: Bucket, prefix: str) -> Scores | None:
    """The scores of a model, None before its first checkpoint.

    Raises:
        ObjectDamaged: The file is unreadable.
    """
    remedy = "Go on with `dr-start-training --resume`, which reconstructs it."
    try:
        return read_record(bucket, keys.deepracer_checkpoints(prefix), Scores.decode, remedy)
    except ObjectMissing:
        return None


def write_scores(bucket: Bucket, prefix: str, scores: Scores) -> None:
    """Write the scores on one line."""
    bucket.put(keys.deepracer_checkpoints(prefix), scores.encode())


def read_evaluation(bucket: Bucket, prefix: str, number: int) -> EvaluationResult:
    """The result of a checkpoint, by its number.

    Raises:
        ObjectMissing: There is none (yet).
        ObjectDamaged: It is something else.
    """
    remedy = "Delete it; the next checkpoint is evaluated again."
    key = keys.evaluation_result(prefix, number)
    return read_record(bucket, key, EvaluationResult.decode, remedy)


def write_evaluation(bucket: Bucket, prefix: str, number: int, result: EvaluationResult) -> None:
    """Publish the result of a checkpoint, by its number."""
    bucket.put(keys.evaluation_result(prefix, number), result.encode())


def evaluated_numbers(bucket: Bucket, prefix: str) -> list[int]:
    """Numbers of the checkpoints whose results are in the bucket, in order."""
    folder = keys.evaluations_folder(prefix)
    found = (
        re.fullmatch(r"(\d+)\.json", info.key.removeprefix(folder)) for info in bucket.list(folder)
    )
    return sorted(int(match[1]) for match in found if match is not None)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _mean_lap_ms(result: EvaluationResult) -> float:
    unfinished = len(result.progress) - len(result.lap_s)
    return _mean([1000.0 * lap_s for lap_s in result.lap_s] + [UNFINISHED_MS] * unfinished)


def _beats(score: Score, best: Score, *, lower_is_better: bool) -> bool:
    if best.avg_eval_metric is None:
        return True
    if score.avg_eval_metric is None:
        return False
    if score.avg_eval_metric == best.avg_eval_metric:
        if score.tie_break is None or best.tie_break is None:
            return True
        return score.tie_break <= best.tie_break
    return (score.avg_eval_metric < best.avg_eval_metric) == lower_is_better
