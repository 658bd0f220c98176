"""How a checkpoint did in its evaluation episodes: written by worker 0, read by the trainer."""

from dataclasses import dataclass

from drcli.base.json_record import JsonRecord, Misfit
from drcli.exchange.checkpoint import checkpoint_name


@dataclass(frozen=True)
class EvaluationResult(JsonRecord):
    """The evaluation episodes of one checkpoint.

    Attributes:
        checkpoint: Name of what drove.
        progress: Percent of the lap that each episode completed; never empty.
        reward: Sum of rewards of each.
        lap_s: Simulated seconds of those that completed their lap.
    """

    checkpoint: str
    progress: list[float]
    reward: list[float]
    lap_s: list[float]

    def __post_init__(self) -> None:
        if not self.progress or len(self.reward) != len(self.progress):
            raise Misfit("it needs one progress and one reward for each episode")
        if len(self.lap_s) > len(self.progress):
            raise Misfit("it has more laps than episodes")
        checkpoint_name(self.checkpoint)
