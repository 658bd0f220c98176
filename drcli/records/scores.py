"""How well checkpoints drive, and `deepracer_checkpoints.json`."""

import json
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from drcli.base.json_record import JsonRecord, RecordError, SafeInt, Seconds, decode_json
from drcli.records.checkpoint import NameText
from drcli.records.iteration import Laps

JudgedWorld = Literal["training", "evaluation", "both"]


@dataclass(frozen=True)
class EvaluationEpisodes:
    """Driven to the first violation; progress in percent, `lap_s` of clean laps."""

    progress: list[float]
    reward: list[float]
    lap_s: list[Seconds]

    def __post_init__(self) -> None:
        if not self.progress or len(self.reward) != len(self.progress):
            raise RecordError("an evaluation needs one progress and one reward for each episode")
        if len(self.lap_s) > len(self.progress):
            raise RecordError("an evaluation has more laps than episodes")

    @property
    def laps(self) -> Laps:
        return Laps(len(self.progress), self.lap_s)

    @property
    def mean_progress(self) -> float:
        return sum(self.progress) / len(self.progress)

    def and_again(self, other: "EvaluationEpisodes | None") -> "EvaluationEpisodes":
        if other is None:
            return self
        return EvaluationEpisodes(
            [*self.progress, *other.progress],
            [*self.reward, *other.reward],
            [*self.lap_s, *other.lap_s],
        )


@dataclass(frozen=True)
class SecondEvaluation(EvaluationEpisodes):
    """On tracks that are not trained.

    Attributes:
        world: The track, or how many there are.
        failed: Those with a lap that was not clean.
    """

    world: str
    failed: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class EvaluationResult(JsonRecord):
    """The evaluation of one checkpoint: worker 0 writes it, the trainer reads it.

    Attributes:
        progress: Percent of each; never empty.
        lap_s: Completed laps, simulated seconds.
        steering_per_m: Changes of the steering's side.
        rollbacks: Before the checkpoint.
        confirms: Laps to drive again from other starts, because these may end the training or make
            it the best.
    """

    checkpoint: NameText
    progress: list[float]
    reward: list[float]
    lap_s: list[Seconds]
    steering_per_m: float | None = None
    rollbacks: SafeInt = 0
    second: SecondEvaluation | None = None
    confirms: SafeInt = 0
    confirmation: EvaluationEpisodes | None = None

    def __post_init__(self) -> None:
        _ = self.first  # checks the lists

    @property
    def first(self) -> EvaluationEpisodes:
        return EvaluationEpisodes(self.progress, self.reward, self.lap_s)

    def on(self, world: JudgedWorld) -> EvaluationEpisodes:
        """All episodes on these tracks, as if one track.

        Of both, as many of each, so without what was driven again.
        """
        if self.second is None or world == "training":
            return self.first.and_again(self.confirmation)
        return self.second if world == "evaluation" else self.first.and_again(self.second)


NOT_EVALUATED = -1.0


@dataclass(frozen=True)
class Score:
    """`time_stamp` is simulated seconds; older tools leave out unknown values."""

    name: NameText
    avg_eval_metric: float | None = None
    time_stamp: Seconds = 0.0
    episodes: EvaluationEpisodes | None = None


@dataclass(frozen=True)
class Scores:
    """The best checkpoint and the newest, as in the file.

    Some tools split its text instead of reading JSON, so our own key comes last.
    """

    best_checkpoint: Score
    last_checkpoint: Score

    def metric_of(self, name: str) -> float | None:
        known = (self.best_checkpoint, self.last_checkpoint)
        return next((score.avg_eval_metric for score in known if score.name == name), None)

    def encode(self) -> bytes:
        best, last = _entry(self.best_checkpoint), _entry(self.last_checkpoint)
        entries = {"best_checkpoint": best, "last_checkpoint": last}
        return _file(entries, self.best_checkpoint)

    @staticmethod
    def decode(data: bytes) -> "Scores":
        """RecordError without a best and a last checkpoint."""
        scores = decode_json(Scores, data)
        episodes = decode_json(_OwnKeys, data).best_episodes
        best = replace(scores.best_checkpoint, episodes=episodes)
        return Scores(_known_metric(best), _known_metric(scores.last_checkpoint))


def _known_metric(score: Score) -> Score:
    if score.avg_eval_metric == NOT_EVALUATED and score.episodes is None:
        return replace(score, avg_eval_metric=None)
    return score


def encode_single(score: Score) -> bytes:
    """The file of a single checkpoint, the last one first.

    Older tools call the metric `avg_comp_pct`.
    """
    entry = _entry(score)
    entry["avg_comp_pct"] = entry["avg_eval_metric"]
    return _file({"last_checkpoint": entry, "best_checkpoint": entry}, score)


@dataclass(frozen=True)
class _OwnKeys:
    best_episodes: EvaluationEpisodes | None = None


def _entry(score: Score) -> dict[str, Any]:
    """Other tools want a number before an evaluation too."""
    entry = asdict(score)
    del entry["episodes"]
    if score.avg_eval_metric is None:
        entry["avg_eval_metric"] = NOT_EVALUATED
    return entry


def _file(entries: dict[str, Any], best: Score) -> bytes:
    own = {} if best.episodes is None else asdict(_OwnKeys(best.episodes))
    return json.dumps({**entries, **own}, allow_nan=False).encode()
