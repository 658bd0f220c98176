"""Fresh starts of evaluation laps, each a little off the ideal start.

A deterministic policy drives each lap from the same start alike. The spread is that of a car
set down by hand.
"""

import numpy as np

from drcli.workers.driven_episode import Plan
from drsim.episode.start_poses import start_pose
from drsim.track.track import Track

OFFSET_SHARE = 0.1
ANGLE_DEG = 3.0


def fresh_starts(track: Track, count: int, seed: int) -> list[Plan]:
    """Plans in the order of the lap, drawn from the seed.

    One start lies in each of `count` equal parts; on an open track all are at its beginning.
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
    distance_m = np.array([fraction * track.length_m])
    # The lanes lie midway between the centre line and the borders.
    inner, outer = (track.pose_at(distance_m, lane)[0] for lane in ("inner", "outer"))
    return 2.0 * float(np.hypot(*(outer - inner)[:2]))
