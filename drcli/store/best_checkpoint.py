"""Decides which checkpoint is the best, and reads and writes evaluation results and scores.

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
    """An evaluation by DR_TRAIN_BEST_MODEL_METRIC: percent, reward or milliseconds."""
    if metric == "laptime":
        return _mean_lap_ms(result)
    return _mean(result.reward if metric == "reward" else result.progress)


def tie_break_of(metric: str, result: EvaluationResult) -> float:
    """Decides between equal means, the lower the better: lap time, or progress for `laptime`."""
    return -_mean(result.progress) if metric == "laptime" else _mean_lap_ms(result)


def score_of(result: EvaluationResult, metric: str, time_stamp: float) -> Score:
    """The score of a checkpoint that was made at some simulated time, seconds."""
    tie_break = tie_break_of(metric, result)
    return Score(result.checkpoint, metric_of(metric, result), time_stamp, tie_break)


def with_evaluation(scores: Scores, score: Score, metric: str) -> Scores:
    """The scores after the evaluation of a checkpoint.

    It beats a checkpoint that was never evaluated. The tie-break decides between equal means; if it
    is equal too, or unknown, the later evaluation wins.
    """
    best, last = scores.best_checkpoint, scores.last_checkpoint
    is_best = score.name == best.name or _beats(score, best, lower_is_better=metric == "laptime")
    return Scores(
        best_checkpoint=score if is_best else best,
        last_checkpoint=score if score.name == last.name else last,
    )


def read_scores(bucket: Bucket, prefix: str) -> Scores | None:
    """The scores of a model, None before its first checkpoint; ObjectDamaged if unreadable."""
    remedy = "Continue with `dr-start-training --resume`, which reconstructs it."
    try:
        return read_record(bucket, keys.deepracer_checkpoints(prefix), Scores.decode, remedy)
    except ObjectMissing:
        return None


def write_scores(bucket: Bucket, prefix: str, scores: Scores) -> None:
    """Write `deepracer_checkpoints.json`."""
    bucket.put(keys.deepracer_checkpoints(prefix), scores.encode())


def forget_scores(bucket: Bucket, prefix: str) -> None:
    """Keep the best checkpoint, but not its score: the next evaluation beats it."""
    known = read_scores(bucket, prefix)
    if known is not None:
        best, last = unscored(known.best_checkpoint), unscored(known.last_checkpoint)
        write_scores(bucket, prefix, Scores(best, last))


def unscored(score: Score) -> Score:
    """A checkpoint as if it was not evaluated yet."""
    return replace(score, avg_eval_metric=None, tie_break=None)


def read_evaluation(bucket: Bucket, prefix: str, number: int) -> EvaluationResult:
    """The result of a checkpoint, by its number; ObjectMissing or ObjectDamaged."""
    remedy = "Delete it; the next checkpoint is evaluated again."
    key = keys.evaluation_result(prefix, number)
    return read_record(bucket, key, EvaluationResult.decode, remedy)


def write_evaluation(bucket: Bucket, prefix: str, number: int, result: EvaluationResult) -> None:
    """Publish the result of a checkpoint, by its number."""
    bucket.put(keys.evaluation_result(prefix, number), result.encode())


def evaluated_numbers(bucket: Bucket, prefix: str) -> list[int]:
    """Numbers of the evaluated checkpoints, in order."""
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
