"""The phase that a training with a teacher is in."""

from dataclasses import dataclass

from drcli.learn.phases import Phase


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
