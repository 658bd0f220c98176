"""Decides which checkpoint is best; reads and writes evaluation results and scores.

Worker 0 writes results; the trainer compares them (`drcli.train.scoring`).
"""

import re
from collections.abc import Sequence
from dataclasses import replace

from drcli.bucket.bucket import find_record, read_record
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import checkpoint_name
from drcli.records.iteration import CONFIRMING_CLEAN, CONFIRMING_LAPS, share_interval
from drcli.records.scores import EvaluationEpisodes, EvaluationResult, Score, Scores

UNFINISHED_MS = 999_999.0
"""Source: the reference simulator."""

RELIABLE = share_interval(20 + CONFIRMING_CLEAN, 20 + CONFIRMING_LAPS)[0]
"""Lower bound of the share of clean laps above which the faster checkpoint is better.

It is a goal's: 20 laps, then 38 of 40. Without it, one lucky clean lap more could decide.
"""

PRESUMED = share_interval(5, 5)[0]
"""The bound where only a mean is known: of five clean laps, as in DeepRacer-for-Cloud."""


def metric_of(metric: str, episodes: EvaluationEpisodes) -> float:
    """Percent, reward or milliseconds."""
    if metric == "laptime":
        unfinished = len(episodes.progress) - len(episodes.lap_s)
        times = [1000.0 * lap_s for lap_s in episodes.lap_s]
        return _mean([*times, *[UNFINISHED_MS] * unfinished])
    return _mean(episodes.reward) if metric == "reward" else episodes.mean_progress


def score_of(
    checkpoint: str, episodes: EvaluationEpisodes, metric: str, time_stamp: float
) -> Score:
    return Score(checkpoint, metric_of(metric, episodes), time_stamp, episodes)


def with_evaluation(
    scores: Scores, score: Score, metric: str, *, reaches_goal: bool = False
) -> Scores:
    """A checkpoint that reaches a goal is the best."""
    best, last = scores.best_checkpoint, scores.last_checkpoint
    is_best = reaches_goal or score.name == best.name or is_better(score, best, metric)
    return Scores(
        best_checkpoint=score if is_best else best,
        last_checkpoint=score if score.name == last.name else last,
    )


def is_better(score: Score, best: Score, metric: str) -> bool:
    """Whether a checkpoint that is evaluated later is better than the best so far.

    By metric "reward", the higher mean. Otherwise, and between equals: the higher lower bound of
    the share of clean laps, up to `RELIABLE`; then the lower median clean lap, or without any the
    higher mean progress; then the later. Never evaluated is worst.
    """
    if best.avg_eval_metric is None or score.avg_eval_metric is None:
        return best.avg_eval_metric is None
    if score.episodes is None or best.episodes is None:  # of version 0.1.0, or of other programs
        own_laps = None if score.episodes is None else score.episodes.laps
        if own_laps is not None and metric != "reward" and own_laps.interval[0] >= PRESUMED:
            return True
        if metric == "laptime":
            return score.avg_eval_metric <= best.avg_eval_metric
        return score.avg_eval_metric >= best.avg_eval_metric
    mean = metric == "reward"
    own = (mean * score.avg_eval_metric, *_rank(score.episodes))
    return own >= (mean * best.avg_eval_metric, *_rank(best.episodes))


def is_hopeful(scores: Scores | None, result: EvaluationResult, metric: str) -> bool:
    """Whether it would be the best if it drove as well again.

    Without a completed lap it need not: how far such checkpoints get varies little.
    """
    if scores is None or not result.lap_s:
        return False
    twice = score_of(result.checkpoint, result.first.and_again(result.first), metric, 0.0)
    best = scores.best_checkpoint
    return twice.name == best.name or is_better(twice, best, metric)


def _rank(episodes: EvaluationEpisodes) -> tuple[float, float]:
    laps = episodes.laps
    median_s = laps.median_s
    bound = min(RELIABLE, laps.interval[0])
    return bound, episodes.mean_progress if median_s is None else -median_s


def read_scores(model: ModelStore) -> Scores | None:
    """None before the first checkpoint; raises ObjectDamaged."""
    return find_record(model.bucket, keys.deepracer_checkpoints(model.prefix), Scores.decode)


def write_scores(model: ModelStore, scores: Scores) -> None:
    model.bucket.put(keys.deepracer_checkpoints(model.prefix), scores.encode())


def forget_scores(model: ModelStore) -> None:
    """Keep the best checkpoint without its score, which any evaluation beats.

    Unless it is the newest, which is driven again.
    """
    known = read_scores(model)
    if known is not None:
        best, last = unscored(known.best_checkpoint), unscored(known.last_checkpoint)
        write_scores(model, Scores(best, last))
        model.bucket.delete(
            [keys.evaluation_result(model.prefix, checkpoint_name(last.name).number)]
        )


def unscored(score: Score) -> Score:
    return replace(score, avg_eval_metric=None, episodes=None)


def read_evaluation(model: ModelStore, number: int) -> EvaluationResult:
    key = keys.evaluation_result(model.prefix, number)
    return read_record(model.bucket, key, EvaluationResult.decode)


def write_evaluation(model: ModelStore, number: int, result: EvaluationResult) -> None:
    model.bucket.put(keys.evaluation_result(model.prefix, number), result.encode())


def evaluated_numbers(model: ModelStore) -> list[int]:
    folder = keys.evaluations_folder(model.prefix)
    found = (
        re.fullmatch(r"(\d+)\.json", info.key.removeprefix(folder))
        for info in model.bucket.list(folder)
    )
    return sorted(int(match[1]) for match in found if match is not None)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
