"""Writes a line into the log of a worker for each episode that has ended."""

from typing import Any

from drcli.base import log
from drcli.exchange.episode_metrics import TrialMetrics
from drcli.exchange.laps import lap_time
from drcli.exchange.trace import STATUS_LABELS, Episode

_logger = log.get_logger(__name__)


def log_training(episode: Episode, iteration: int, worker: int) -> None:
    _log(
        "episode",
        f"Episode {episode.number} of iteration {iteration}",
        episode,
        iteration=iteration,
        worker=worker,
    )


def log_evaluation(episode: Episode, checkpoint: int, worker: int) -> None:
    _log(
        "evaluation",
        f"Evaluation episode {episode.number} of checkpoint {checkpoint}",
        episode,
        checkpoint=checkpoint,
        worker=worker,
    )


def log_trial(episode: Episode, model: str) -> None:
    record = TrialMetrics.of(episode)
    penalty_s = (record.penalty_in_milliseconds or 0.0) / 1000.0
    _log(
        "trial",
        f"Trial {episode.number + 1} of {model}",
        episode,
        time=lap_time(episode.duration_s, penalty_s, record.reset_count),
        model=model,
        resets=record.reset_count,
        penalty_s=penalty_s,
    )


def _log(kind: str, what: str, episode: Episode, *, time: str = "", **facts: Any) -> None:
    status = STATUS_LABELS.get(episode.status, episode.status)
    log.event(
        _logger,
        kind,
        f"{what}: {status.lower()} at {episode.progress:.1f} % after {episode.steps} steps "
        f"({time or f'{episode.duration_s:.3f} s'}), reward {episode.reward:.2f}.",
        **facts,
        episode=episode.number,
        status=episode.status,
        progress=round(float(episode.progress), 4),
        steps=episode.steps,
        duration_s=round(float(episode.duration_s), 4),
        reward=round(float(episode.reward), 4),
        start_waypoint=int(episode.rows[0].closest_waypoint),
        end_waypoint=int(episode.rows[-1].closest_waypoint),
        crashes=int(episode.rows[-1].crashes),
    )
