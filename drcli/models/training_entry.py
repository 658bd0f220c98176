"""A training in short, and its settings with defaults."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from drcli.config.settings import catalogue
from drcli.exchange.training_record import TrainingRecord


@dataclass(frozen=True)
class TrainingEntry:
    """A training in the list.

    Attributes:
        id: Eight hexadecimal digits.
        model: Prefix of the model.
        state: running, finished, stopped, interrupted, failed, lost or unknown.
        message: Why it ended.
        began_at: Time of its first start in UTC, ISO 8601; empty if unknown.
        ended_at: Time of its end, likewise.
        exists: Whether its model is still there.
        derived: Whether this was worked out from the model, as nobody wrote a record.
        world: Track.
        race_type: DR_RACE_TYPE.
        algorithm: clipped_ppo or sac.
        action_space: Kind and number of actions.
        workers: Simulation workers.
        starts: How often it was started.
        iterations: Finished iterations.
        episodes: Training episodes.
        steps: Steps learned from.
        elapsed_s: Wall time of training.
        hours: Machine hours of all starts.
        usd: What these cost.
        best_lap_s: Fastest clean lap of an evaluation on `world`, during the training or later.
        best_training_lap_s: Fastest lap of a training episode on `world`.
        best_progress: Highest mean progress of an evaluation on `world`, percent.
        best_checkpoint: Name of the best checkpoint.
        best_score: Its score.
        mean_reward: Of the last iteration.
        mean_progress: Of the last iteration, percent.
        parent: The model with whose weights it began; empty for fresh ones.
        parent_checkpoint: Name of that checkpoint.
        parent_training: Id of the training that made it; empty if unknown.
        host: Machine of the newest start.
        processor: Of that machine.
        drcli: Version of drcli of the newest start.
        commit: Git commit of the working folder, with + if files were changed.
        seed: Of its random numbers.
        description: DR_MODEL_DESCRIPTION.
        metric: DR_TRAIN_BEST_MODEL_METRIC, of which the score is; empty if unknown.
    """

    id: str
    model: str
    state: str
    message: str
    began_at: str
    ended_at: str
    exists: bool
    derived: bool
    world: str
    race_type: str
    algorithm: str
    action_space: str
    workers: int | None
    starts: int
    iterations: int
    episodes: int
    steps: int
    elapsed_s: float
    hours: float | None
    usd: float | None
    best_lap_s: float | None
    best_training_lap_s: float | None
    best_progress: float | None
    best_checkpoint: str | None
    best_score: float | None
    mean_reward: float | None
    mean_progress: float | None
    parent: str
    parent_checkpoint: str
    parent_training: str
    host: str
    processor: str
    drcli: str
    commit: str
    seed: int | None
    description: str
    metric: str


def entry_of(record: TrainingRecord, *, exists: bool) -> TrainingEntry:
    newest, results, parent = record.newest, record.results, record.parent
    git = newest.git.get("working_folder")
    return TrainingEntry(
        id=record.id,
        model=record.prefix,
        state=record.state,
        message=record.message,
        began_at=moment_text(record.began_at),
        ended_at=moment_text(record.ended_at),
        exists=exists,
        derived=record.derived,
        world=record.world,
        race_type=record.race_type,
        algorithm=record.algorithm,
        action_space=record.action_space,
        workers=record.workers,
        starts=record.number_of_starts,
        iterations=results.iterations,
        episodes=results.episodes,
        steps=results.steps,
        elapsed_s=results.elapsed_s,
        hours=record.hours,
        usd=record.usd,
        best_lap_s=results.clean_lap_s(record.world),
        best_training_lap_s=results.best_training_lap_s,
        best_progress=results.best_progress,
        best_checkpoint=results.best_checkpoint,
        best_score=results.best_score,
        mean_reward=results.mean_reward,
        mean_progress=results.mean_progress,
        parent="" if parent is None else parent.prefix,
        parent_checkpoint="" if parent is None else parent.name,
        parent_training=record.parent_training,
        host=newest.host,
        processor=str(newest.machine.get("processor") or ""),
        drcli=newest.versions.get("drcli") or "",
        commit="" if git is None else f"{git.commit[:12]}{'+' if git.dirty else ''}",
        seed=newest.seed,
        description=record.description,
        metric=record.metric,
    )


def moment_text(at: float | None) -> str:
    """A time in Unix seconds as ISO 8601 in UTC; empty if unknown."""
    if not at:
        return ""
    try:
        return datetime.fromtimestamp(at, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (ValueError, OverflowError, OSError):
        return ""


def settings_of(record: TrainingRecord) -> dict[str, Any]:
    given = record.newest.settings
    if given is None:
        return {}
    defaults = {
        name: setting.default_text if setting.kind in ("path", "list") else setting.default
        for name, setting in catalogue().items()
        if setting.effect == "used"
    }
    return {**defaults, **given}
