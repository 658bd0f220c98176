"""Where episodes end."""

from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.driven_steps import DrivenSteps
from drsim.arrays import Bools

PARTS = 20


@dataclass(frozen=True)
class EndsInPart:
    first: int
    last: int
    ends: int
    passes: int

    @property
    def share(self) -> float:
        return self.ends / self.passes if self.passes else 0.0


@dataclass(frozen=True)
class EpisodeEnds:
    """Ends of the episodes late in a training.

    Attributes:
        parts: Twenty, by waypoints.
        densest: The stretch of a part's length with the most ends. It may begin in the middle of a
            part, so that a place on a border is not cut in half.
    """

    episodes: int
    complete: int
    parts: tuple[EndsInPart, ...]
    worst: int | None
    densest: EndsInPart | None


def episode_ends(late: DrivenSteps) -> EpisodeEnds | None:
    if not len(late):
        return None
    complete = late.progress[late.last] >= 100.0
    places = int(max(late.waypoint.max(), 0)) + 1
    size = min(PARTS, places)
    parts = _stretches(late, complete, places, size, width=1)
    worst = max(range(size), key=lambda n: parts[n].ends)
    shifted = parts if 2 * size > places else _stretches(late, complete, places, 2 * size, width=2)
    densest = max(shifted, key=lambda part: part.ends)
    return EpisodeEnds(
        episodes=int(late.last.sum()),
        complete=int(complete.sum()),
        parts=parts,
        worst=worst if parts[worst].ends else None,
        densest=densest if densest.ends else None,
    )


def _stretches(
    late: DrivenSteps, complete: Bools, places: int, cells: int, width: int
) -> tuple[EndsInPart, ...]:
    cell = np.maximum(late.waypoint, 0) * cells // places
    ends = np.bincount(cell[late.last][~complete], minlength=cells)
    seen = np.zeros((int(late.episode[-1] - late.episode[0]) + 1, cells), dtype=bool)
    seen[late.episode - late.episode[0], cell] = True  # far faster than to sort the pairs
    count = cells - width + 1
    passes = np.any([seen[:, n : n + count] for n in range(width)], axis=0).sum(axis=0)
    return tuple(
        EndsInPart(
            first=-(-n * places // cells),
            last=-(-(n + width) * places // cells) - 1,
            ends=int(ends[n : n + width].sum()),
            passes=int(passes[n]),
        )
        for n in range(count)
    )
