"""How a checkpoint did in its evaluation episodes: written by worker 0, scored by the trainer."""

import re
from dataclasses import asdict, dataclass

from drcli.base.json_record import Misfit, built
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, get_json, put_json


@dataclass(frozen=True)
class EvaluationResult:
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
        if keys.CheckpointName.parse(self.checkpoint) is None:
            raise Misfit("'checkpoint' is not the name of a checkpoint")

    @property
    def columns(self) -> dict[str, list[float]]:
        """What a metric is worked out from."""
        return {"progress": self.progress, "reward": self.reward, "lap_s": self.lap_s}


def write_evaluation(bucket: Bucket, prefix: str, number: int, result: EvaluationResult) -> None:
    """Publish the result of a checkpoint, by its number."""
    put_json(bucket, keys.evaluation_result(prefix, number), asdict(result))


def read_evaluation(bucket: Bucket, prefix: str, number: int) -> EvaluationResult:
    """The result of a checkpoint, by its number.

    Raises:
        ObjectMissing: There is none (yet).
        ObjectDamaged: It is something else.
    """
    key = keys.evaluation_result(prefix, number)
    try:
        return built(EvaluationResult, get_json(bucket, key))
    except Misfit as e:
        raise ObjectDamaged(
            f"{bucket.name}/{key} is damaged: {e}.",
            remedy="Delete it; the next checkpoint is evaluated again.",
        ) from e


def evaluated_numbers(bucket: Bucket, prefix: str) -> list[int]:
    """Numbers of the checkpoints whose results lie there, in order."""
    folder = keys.evaluations_folder(prefix)
    found = (
        re.fullmatch(r"(\d+)\.json", info.key.removeprefix(folder)) for info in bucket.list(folder)
    )
    return sorted(int(match[1]) for match in found if match is not None)
