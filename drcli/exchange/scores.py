"""How well checkpoints drive: evaluations, and `deepracer_checkpoints.json`."""

import json
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from drcli.base.json_record import JsonRecord, RecordError, from_json, parse_json
from drcli.exchange.checkpoint import checkpoint_name
from drcli.exchange.laps import Laps

JudgedWorld = Literal["training", "evaluation", "both"]
"""Whose evaluations decide which checkpoint is best: DR_TRAIN_BEST_MODEL_WORLD."""


@dataclass(frozen=True)
class EvaluationEpisodes:
    """Evaluation episodes of a checkpoint, each driven to its first violation.

    Attributes:
        progress: Percent of the lap, for each episode; never empty.
        reward: Sum of rewards, for each episode.
        lap_s: Times of the completed laps, which are clean, simulated seconds.
    """

    progress: list[float]
    reward: list[float]
    lap_s: list[float]

    def __post_init__(self) -> None:
        if not self.progress or len(self.reward) != len(self.progress):
            raise RecordError("an evaluation needs one progress and one reward for each episode")
        if len(self.lap_s) > len(self.progress):
            raise RecordError("an evaluation has more laps than episodes")

    @property
    def laps(self) -> Laps:
        """How many of them completed their lap, and how fast."""
        return Laps(len(self.progress), self.lap_s)

    @property
    def mean_progress(self) -> float:
        """Percent of the lap."""
        return sum(self.progress) / len(self.progress)

    def and_again(self, other: "EvaluationEpisodes | None") -> "EvaluationEpisodes":
        """These episodes and others of the same checkpoint, if there are any."""
        if other is None:
            return self
        return EvaluationEpisodes(
            [*self.progress, *other.progress],
            [*self.reward, *other.reward],
            [*self.lap_s, *other.lap_s],
        )


@dataclass(frozen=True)
class SecondEvaluation(EvaluationEpisodes):
    """The evaluation episodes of a checkpoint on a second track, DR_TRAIN_EVAL_WORLD.

    Attributes:
        world: Name of the track.
    """

    world: str


@dataclass(frozen=True)
class EvaluationResult(JsonRecord):
    """The evaluation episodes of one checkpoint: worker 0 writes it, the trainer reads it.

    Attributes:
        checkpoint: Name.
        progress: Percent of the lap, for each episode; never empty.
        reward: Sum of rewards, for each episode.
        lap_s: Times of the completed laps, simulated seconds.
        steering_per_m: How often the steering changed its side in each metre; None if unknown.
        rollbacks: How often the training had gone back when the checkpoint was published.
        second: Its evaluation on a second track, which comes later; None without one.
        confirms: How many laps the checkpoint drives again, from other starts, because these
            episodes are good enough to end the training or to make it the best.
        confirmation: What it drove again; None before that.
    """

    checkpoint: str
    progress: list[float]
    reward: list[float]
    lap_s: list[float]
    steering_per_m: float | None = None
    rollbacks: int = 0
    second: SecondEvaluation | None = None
    confirms: int = 0
    confirmation: EvaluationEpisodes | None = None

    def __post_init__(self) -> None:
        checkpoint_name(self.checkpoint)
        _ = self.first  # checks the lists

    @property
    def first(self) -> EvaluationEpisodes:
        """The episodes on the training track, without those that were driven again."""
        return EvaluationEpisodes(self.progress, self.reward, self.lap_s)

    def on(self, world: JudgedWorld) -> EvaluationEpisodes:
        """All episodes on these tracks, as if there were one track.

        Of both, as many on each: what was driven again on the training track does not count.
        """
        if self.second is None or world == "training":
            return self.first.and_again(self.confirmation)
        return self.second if world == "evaluation" else self.first.and_again(self.second)


NOT_EVALUATED = -1.0
"""What files of older tools have in place of a metric before an evaluation."""


@dataclass(frozen=True)
class Score:
    """How well a checkpoint drives; older tools leave out values that they do not know.

    Attributes:
        name: Checkpoint.
        avg_eval_metric: Mean of its evaluation episodes; None before its evaluation.
        time_stamp: Simulated seconds when the checkpoint was made.
        episodes: All its evaluation episodes, by which checkpoints are compared; None if unknown.
    """

    name: str
    avg_eval_metric: float | None = None
    time_stamp: float = 0.0
    episodes: EvaluationEpisodes | None = None


@dataclass(frozen=True)
class Scores:
    """The best checkpoint and the newest one, which is not evaluated yet when it is new.

    The field names are those of the file. Some tools split its text instead of reading JSON, so
    our own key, the episodes of the best, comes last.
    """

    best_checkpoint: Score
    last_checkpoint: Score

    def metric_of(self, name: str) -> float | None:
        """The metric of a checkpoint; None if it is neither of the two."""
        known = (self.best_checkpoint, self.last_checkpoint)
        return next((score.avg_eval_metric for score in known if score.name == name), None)

    def encode(self) -> bytes:
        """The file, on one line."""
        best, last = _entry(self.best_checkpoint), _entry(self.last_checkpoint)
        entries = {"best_checkpoint": best, "last_checkpoint": last}
        return _file(entries, self.best_checkpoint)

    @staticmethod
    def decode(data: bytes) -> "Scores":
        """The scores in the file; RecordError if it does not name a best and a last checkpoint."""
        file = parse_json(data)
        scores = from_json(Scores, file)
        for score in (scores.best_checkpoint, scores.last_checkpoint):
            checkpoint_name(score.name)
        episodes = from_json(_OwnKeys, file).best_episodes
        best = replace(scores.best_checkpoint, episodes=episodes)
        return Scores(_known_metric(best), _known_metric(scores.last_checkpoint))


def _known_metric(score: Score) -> Score:
    """Without the number that stands for no metric, unless the episodes show that it is one."""
    if score.avg_eval_metric == NOT_EVALUATED and score.episodes is None:
        return replace(score, avg_eval_metric=None)
    return score


def encode_single(score: Score) -> bytes:
    """The file of a model with a single checkpoint, as after an upload: the last one comes first.

    Older tools call the metric `avg_comp_pct`, and have a number before an evaluation too.
    """
    entry = _entry(score)
    metric = score.avg_eval_metric
    entry["avg_comp_pct"] = NOT_EVALUATED if metric is None else metric
    return _file({"last_checkpoint": entry, "best_checkpoint": entry}, score)


@dataclass(frozen=True)
class _OwnKeys:
    best_episodes: EvaluationEpisodes | None = None


def _entry(score: Score) -> dict[str, Any]:
    entry = asdict(score)
    del entry["episodes"]
    return entry


def _file(entries: dict[str, Any], best: Score) -> bytes:
    own = {} if best.episodes is None else asdict(_OwnKeys(best.episodes))
    return json.dumps({**entries, **own}, allow_nan=False).encode()
