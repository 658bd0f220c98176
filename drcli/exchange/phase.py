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
"""All phases in order, and what each is for people."""


@dataclass(frozen=True)
class PhaseMark:
    """A phase, and what was counted when it began.

    Attributes:
        name: Of the phase.
        iteration: Number of its first checkpoint.
        steps: Steps learned from before it.
    """

    name: Phase
    iteration: int = 0
    steps: int = 0

    @property
    def number(self) -> int:
        """Its place among the phases, from 1."""
        return list(PHASES).index(self.name) + 1

    def __str__(self) -> str:
        """Such as "phase 1 of 3, teacher (sees the track, no camera)"."""
        return f"phase {self.number} of {len(PHASES)}, {self.name} ({PHASES[self.name]})"


def is_untaught(history: Sequence[IterationRecord], number: int) -> bool:
    """Whether the camera policy of a checkpoint has not learned in its training yet.

    Until its number, only the teacher has. `history` has all iterations.
    """
    earlier = (record for record in history if record.iteration < number)
    return any(record.phase for record in history) and all(
        record.phase == "teacher" for record in earlier
    )
