"""The phase that a training with a teacher is in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drcli.exchange.iteration import IterationRecord
from drcli.learn.phases import Phase

PHASES: Mapping[Phase, str] = {
    "teacher": "sees the track, no camera",
    "distillation": "teaches the camera",
    "ppo": "the camera, by itself",
}


@dataclass(frozen=True)
class PhaseMark:
    name: Phase
    iteration: int = 0
    steps: int = 0

    @property
    def number(self) -> int:
        return list(PHASES).index(self.name) + 1

    def __str__(self) -> str:
        """Such as "phase 1 of 3, teacher (sees the track, no camera)"."""
        return f"phase {self.number} of {len(PHASES)}, {self.name} ({PHASES[self.name]})"


def is_untaught(history: Sequence[IterationRecord], number: int) -> bool:
    """Whether only the teacher had learned before this checkpoint, by the whole history."""
    earlier = (record for record in history if record.iteration < number)
    return any(record.phase for record in history) and all(
        record.phase == "teacher" for record in earlier
    )
