"""Fresh starts of evaluation laps: spread over the lap, each a little off the ideal start.

A deterministic policy drives each lap from the same start alike, so only other starts show how
reliable it is. The spread is that of a car that is set down by hand.
"""

import numpy as np

from drcli.workers.driven_episode import Plan
from drsim.episode.start_poses import start_pose
from drsim.track.track import Track

OFFSET_SHARE = 0.1
"""Most distance from the centre line, as a share of the track's width there."""

ANGLE_DEG = 3.0
"""Most angle to the driving direction."""


def fresh_starts(track: Track, count: int, seed: int) -> list[Plan]:
    """Evaluation episodes from starts that are drawn from the seed.

    One start lies in each of `count` equal parts of the lap. On an open track all are at its
    beginning, because a lap is the way to its end.

    Args:
        track: In the driving direction.
        count: Number of starts, at least 1.
        seed: Equal seeds give equal starts; not negative.

    Returns:
        Plans numbered from 0, in the order of the lap.
    """
    # A name of its own among the random numbers of a seed.
    random = np.random.default_rng([seed, 0x5747])
    parts, sides, turns = random.random((3, count))
    plans = []
    for number in range(count):
        fraction = float((number + parts[number]) / count) if track.closed else 0.0
        most_m = OFFSET_SHARE * _width_m(track, fraction)
        angle_deg = float(ANGLE_DEG * (2.0 * turns[number] - 1.0))
        wanted_m = float(most_m * (2.0 * sides[number] - 1.0))
        pose = start_pose(track, fraction, wanted_m, angle_deg)
        plans.append(
            Plan(number, "evaluation", fraction, offset_m=pose.offset_m, angle_deg=angle_deg)
        )
    return plans


def _width_m(track: Track, fraction: float) -> float:
    """Width of the road at a fraction of the lap, metres."""
    distance_m = np.array([fraction * track.length_m])
    # The lanes lie midway between the centre line and the borders.
    inner, outer = (track.pose_at(distance_m, lane)[0] for lane in ("inner", "outer"))
    return 2.0 * float(np.hypot(*(outer - inner)[:2]))
