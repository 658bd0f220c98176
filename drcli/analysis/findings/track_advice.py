"""Advice on where the car drives and where episodes end."""

import numpy as np

from drcli.analysis.findings.action_advice import LEARNED
from drcli.analysis.findings.advice_item import Advice
from drcli.analysis.findings.evidence import Evidence
from drcli.analysis.findings.reward_advice import REWARD_CHECK
from drcli.analysis.findings.verdict import NOT_LEARNING

OFF_SHARE = 0.2
"""Recorded trainings have 0.04 to 0.1 while they learn."""


OFF_PLACES, OFF_IN_PLACES = 0.1, 0.6
"""Or less, if most of it is at places where every second step is off."""


GETS_ROUND, OFF_LAPS, LAP_PLACES = 0.8, 0.1, 0.03
"""For a car that completes so many of its laps, this share of their steps is enough, or this at
places where most laps are off. Healthy ones have 0.03 and 0.
"""


PLACE_SHARE, PLACE_ENDS, PLACE_PASSES = 0.6, 20, 0.5


def cutting(evidence: Evidence) -> Advice | None:
    off = evidence.off
    if off is None:
        return None
    surely = max(off.sure_share, off.sure_lap_share)
    at_places = surely >= OFF_PLACES and off.places_share >= OFF_IN_PLACES
    in_laps = off.complete_share >= GETS_ROUND and (
        off.sure_lap_share >= OFF_LAPS or off.lap_places_share >= LAP_PLACES
    )
    if surely < OFF_SHARE and not at_places and not in_laps:
        return None
    share = off.share
    if off.lap_share is not None and off.sure_lap_share > off.sure_share:
        share = off.lap_share
    worst = ", ".join(str(place.waypoint) for place in sorted(off.places, key=lambda p: p.waypoint))
    paid = ""
    if off.reward_share is not None and off.reward_share > 0.5:
        paid = f" Such a step still earns {100 * off.reward_share:.0f} % of an ordinary one."
    return Advice(
        "cutting",
        "The car drives with wheels off the track",
        f"In {100 * share:.0f} % of the steps, long before an episode ends, a wheel is off the "
        f"track; most often near waypoint {worst}.{paid} A race counts that, or ends there.",
        {
            "share": share,
            "places_share": off.places_share,
            "lap_places_share": off.lap_places_share,
        },
        "reward_function.py",
        REWARD_CHECK,
    )


def hard_place(evidence: Evidence) -> Advice | None:
    ends, table = evidence.ends, evidence.run.episodes
    part = None if ends is None else ends.densest
    if ends is None or part is None or evidence.level >= LEARNED:
        return None
    if len(evidence.curve) < NOT_LEARNING:
        return None  # the first bend stops every beginner; it is a fault if it goes on doing so
    failed = ends.episodes - ends.complete
    if part.ends < PLACE_ENDS or part.ends < PLACE_SHARE * failed or part.share < PLACE_PASSES:
        return None
    starts = np.asarray(table["start_at"].fillna(-1), dtype=np.int64)
    _, counts = np.unique(starts, return_counts=True)
    if counts.max() < 0.9 * len(starts):
        return None
    return Advice(
        "one-place",
        "Almost every episode ends at the same place",
        f"{part.ends} of {failed} episodes end between waypoints {part.first} and {part.last}, and "
        "all start at the same place. So the car practises the way there again and again, and "
        "rarely what comes after.",
        {"ends": part.ends, "failed": failed, "first": part.first, "last": part.last},
        "DR_TRAIN_CHANGE_START_POSITION",
        "dr-config set DR_TRAIN_CHANGE_START_POSITION=True",
    )
