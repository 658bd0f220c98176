"""The phase of a training with a teacher."""

from collections.abc import Sequence
from dataclasses import dataclass

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.phase import PHASES, PhaseMark
from drcli.learn.phases import Phase


@dataclass(frozen=True)
class PhaseReport:
    """A phase of a training with a teacher.

    Attributes:
        name: teacher, distillation or ppo.
        number: Its place among the phases, from 1.
        count: How many phases there are.
        iterations: Of the phase, until now.
        laps: Training episodes of its newest iteration that completed a lap.
        episodes: All training episodes of that iteration.
        best_lap_s: The fastest of these laps, simulated seconds; None without one.
        imitation_loss: How far the student is from its teacher; None where it is not taught.
        text: The same in words.
    """

    name: Phase
    number: int
    count: int
    iterations: int
    laps: int
    episodes: int
    best_lap_s: float | None
    imitation_loss: float | None
    text: str

    @staticmethod
    def of(mark: PhaseMark | None, history: Sequence[IterationRecord]) -> "PhaseReport | None":
        """The phase of the newest checkpoint; None without a teacher."""
        if mark is None:
            return None
        own = [each for each in history if each.iteration >= mark.iteration and each.phase]
        newest = own[-1] if own else None
        return PhaseReport(
            mark.name,
            mark.number,
            len(PHASES),
            len(own),
            0 if newest is None else newest.full_laps,
            0 if newest is None else newest.episodes,
            None if newest is None else newest.best_lap_s,
            None if newest is None else newest.imitation_loss,
            f"{mark}: {_driven(newest)}",
        )


def _driven(newest: IterationRecord | None) -> str:
    if newest is None:
        return "begins"
    words = f"{newest.full_laps} of {newest.episodes} laps"
    return words if newest.best_lap_s is None else f"{words}, best {newest.best_lap_s:.2f} s"
