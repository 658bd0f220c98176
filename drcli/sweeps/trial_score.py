"""Scores of trainings at an amount of their budget."""

from collections.abc import Sequence
from statistics import fmean

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.laps import share_interval
from drcli.exchange.sweep_record import Metric, Resource, TrialRecord, TrialScore
from drcli.store.best_checkpoint import RELIABLE

SMOOTH = 3
"""Averaged iterations, as episodes vary by chance."""

_FIRST = 1e6
Rank = tuple[float, float, float]
"""Larger is better."""


def amount_of(records: Sequence[IterationRecord], resource: Resource) -> float:
    """Used minutes, steps, episodes or iterations."""
    if not records:
        return 0.0
    episodes = sum(record.episodes for record in records)
    return _used(records[-1], resource, len(records), episodes)


def until(
    records: Sequence[IterationRecord], resource: Resource, amount: float
) -> Sequence[IterationRecord]:
    """The iterations within an amount, and always the first."""
    episodes = 0
    for index, record in enumerate(records):
        episodes += record.episodes
        if _used(record, resource, index + 1, episodes) > amount and index > 0:
            return records[:index]
    return records


def score_of(records: Sequence[IterationRecord], metric: Metric) -> TrialScore | None:
    """None without an iteration."""
    if not records:
        return None
    reward = max(_smoothed([record.mean_reward for record in records]))
    evaluated = [record for record in records if record.evaluation_progress]
    if not evaluated:
        progress = max(_smoothed([record.mean_progress for record in records]))
        return TrialScore(progress=progress, reward=reward)
    scores = [_of_evaluation(record, reward) for record in evaluated]
    return max(scores, key=lambda score: rank(score, metric))


def rank(score: TrialScore | None, metric: Metric) -> Rank:
    """What decides between two trainings.

    By `lap_time` as between checkpoints: the lower bound of the share of clean laps, up to that
    of a reliable checkpoint, then their median time, or without any the progress. Without an
    evaluation, only the progress of training episodes.
    """
    if score is None:
        return (-1.0, 0.0, 0.0)
    reward = score.reward or 0.0
    if metric == "reward":
        return (reward, score.progress, 0.0)
    time = 0.0 if score.lap_s is None else -score.lap_s
    if metric == "progress":
        return (score.progress, time, reward)
    if not score.laps:
        return (0.0, score.progress, reward)
    return (min(RELIABLE, share_interval(score.laps, score.episodes)[0]), time, reward)


def number_of(score: TrialScore | None, metric: Metric) -> float:
    """Leaves out a rank's third value."""
    first, second, _ = rank(score, metric)
    return _FIRST * first + second


def best_of(trials: Sequence[TrialRecord], metric: Metric) -> str:
    """Empty without evaluations, or iterations where reward counts."""
    scored = [
        trial
        for trial in trials
        if trial.score is not None and (trial.score.episodes or metric == "reward")
    ]
    if not scored:
        return ""
    return max(scored, key=lambda trial: rank(trial.score, metric)).name


def _used(record: IterationRecord, resource: Resource, count: int, episodes: int) -> float:
    if resource == "minutes":
        return record.elapsed_s / 60.0
    return float({"steps": record.total_steps, "episodes": episodes, "iterations": count}[resource])


def _of_evaluation(record: IterationRecord, reward: float) -> TrialScore:
    laps = record.all_laps
    assert laps is not None
    return TrialScore(
        checkpoint=record.iteration,  # the evaluation is that of the checkpoint of this number
        laps=laps.clean,
        episodes=laps.driven,
        progress=fmean([*record.evaluation_progress, *record.confirmation_progress]),
        lap_s=laps.median_s,
        reward=reward,
    )


def _smoothed(values: Sequence[float]) -> list[float]:
    window = min(SMOOTH, len(values))
    return [fmean(values[end - window : end]) for end in range(window, len(values) + 1)]
