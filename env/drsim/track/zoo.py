"""Generated circuits: `zoo-17` is the same track bit for bit wherever it is made.

Corners become arcs, the ground is bent a little, the line is smoothed, and what comes too close to
itself is thrown away. Ranges follow the 126 loops of the reference simulator and go beyond them.
"""

import math
import re
from dataclasses import dataclass
from random import Random

import numpy as np

from drsim.arrays import Floats
from drsim.errors import TrackError
from drsim.track.corners import Layout, corners_of, length_of
from drsim.track.route_files import DEFAULT_WIDTH_M, SPACING_M
from drsim.track.track import Track

_NAME = re.compile(r"zoo-(0|[1-9][0-9]{0,6})")

LENGTHS_M, WIDTHS_M, TURNS_M = (8.0, 150.0), (0.4, 3.0), (0.3, 10.0)
"""What `generate` takes: length of the centre line, width of the road, radius of the tightest turn
of the centre line.
"""

_INNER_M = 0.06
"""Least radius of the inner border."""

_SPACINGS_M = (0.1, 0.15, 0.2, 0.25, 0.3, 0.3, 0.4)
_TRIES = 60
_ROUNDS = 12
_STEP_M = 0.05
_HAIRPIN_RAD, _SHARPEST_RAD = math.radians(115.0), math.radians(160.0)
_WIDEST_M = 12.0
_MOST_BEND = 0.3
"""Curvature of a straight line where the ground is bent most, 1/m."""

_DECIMALS = 4
"""Processors differ in the sixteenth."""


@dataclass(frozen=True)
class _Plan:
    """What a circuit is to be like.

    Attributes:
        turn_m: Radius of the tightest turn.
        gap_m: Least ground between two stretches of road.
        open_share: Of the corners that turn as wide as they please; others are tight.
        smooth_m: Standard deviation of the smoothing along the line.
        bent: Of the ground, 0 .. 1.
    """

    layout: Layout
    length_m: float
    width_m: float
    turn_m: float
    gap_m: float
    open_share: float
    smooth_m: float
    bent: float
    spacing_m: float


def number_of(world: str) -> int | None:
    """The number of a generated circuit; None for any other name."""
    found = _NAME.fullmatch(world)
    return None if found is None else int(found.group(1))


def circuit(number: int) -> Track:
    """The track `zoo-N`."""
    random = Random(number)
    while True:
        track = _built(f"zoo-{number}", _drawn(random), random)
        if track is not None:
            return track


def generate(
    name: str,
    *,
    length_m: float | None = None,
    width_m: float | None = None,
    turn_m: float | None = None,
    seed: int = 0,
) -> Track:
    """A circuit of choice; what is left out is drawn.

    Raises:
        TrackError: A value is out of range, or no drivable loop was found.
    """
    asked = {"length_m": length_m, "width_m": width_m, "turn_m": turn_m}
    for key, (low, high) in zip(asked, (LENGTHS_M, WIDTHS_M, TURNS_M), strict=True):
        value = asked[key]
        if value is not None and not low <= value <= high:
            raise TrackError(
                f"{key}={value:g} is outside {low:g} to {high:g} metres. Choose a value within."
            )
    if turn_m is not None and width_m is not None and turn_m < width_m / 2 + _INNER_M:
        raise TrackError(
            f"turn_m={turn_m:g} leaves no room for the inner border of a road of "
            f"width_m={width_m:g}. Give turn_m={width_m / 2 + _INNER_M:.2f} or more, or a smaller "
            "width_m."
        )
    if turn_m is not None and length_m is not None and length_m < 2 * math.pi * turn_m:
        raise TrackError(
            f"length_m={length_m:g} is less than a circle with turn_m={turn_m:g} takes. Give "
            f"length_m={9 * turn_m:.0f} or more, or a smaller turn_m."
        )
    random = Random(seed)
    for _ in range(_TRIES):
        plan = _drawn(random, length_m, width_m, turn_m, SPACING_M)
        track = _built(name, plan, random)
        if track is not None:
            return track
    given = ", ".join(f"{key}={value:g}" for key, value in asked.items() if value is not None)
    raise TrackError(
        f"No drivable loop with {given} was found in {_TRIES} tries. Give a greater length_m, a "
        "smaller width_m or turn_m, or another seed."
    )


def _drawn(
    random: Random,
    length_m: float | None = None,
    width_m: float | None = None,
    turn_m: float | None = None,
    spacing_m: float | None = None,
) -> _Plan:
    def between(low: float, high: float) -> float:
        return low + (high - low) * random.random()

    def scaled(low: float, high: float) -> float:
        return low * math.exp(math.log(high / low) * random.random())

    length = between(16.0, 85.0) if random.random() < 0.6 else scaled(15.0, 40.0)
    length = length_m or max(length, 10 * (turn_m or 0.0))
    # Narrow roads are more frequent than among the community's, because they are harder to learn.
    width = 0.6 + (0.5 if length < 30.0 else 0.9) * random.random() ** 1.7
    width = DEFAULT_WIDTH_M if random.random() < 0.35 else width
    width = width_m or min(width, 2 * ((turn_m or width) - _INNER_M))
    turn = max(0.42 * math.exp(1.1 * random.random() ** 2), width / 2 + _INNER_M)
    turn = turn_m or turn
    gap = between(0.35, 1.0)
    layout = Layout(
        kind=("short", "winding", "winding", "folded", "folded", "folded")[
            int(6 * random.random())
        ],
        length_m=length,
        apart_m=max(scaled(1.2, 2.8), (width + gap) * scaled(1.0, 1.4), 1.8 * turn),
        stretch=scaled(1.0, 2.5),
        lean=max(between(-0.8, 0.4), 0.0),
        pulled=max(between(-0.3, 0.25), 0.0),
        bumps=max(between(-0.3, 0.9), 0.0),
    )
    return _Plan(
        layout=layout,
        length_m=length,
        width_m=width,
        turn_m=turn,
        gap_m=gap,
        open_share=math.sqrt(random.random()),
        smooth_m=turn * between(0.1, 0.4),
        bent=random.random(),
        spacing_m=spacing_m or _SPACINGS_M[int(len(_SPACINGS_M) * random.random())],
    )


def _built(name: str, plan: _Plan, random: Random) -> Track | None:
    """None if no car could drive it."""
    line = _line_along(corners_of(plan.layout, random), plan, random)
    if line is None:
        return None
    center = _evenly(line, round(plan.length_m / plan.spacing_m))
    center *= plan.length_m / length_of(center)
    if random.random() < 0.5:
        center = center[::-1]
    center = np.round(center - center.min(axis=0) + plan.width_m, _DECIMALS)
    if not _is_drivable(center, plan):
        return None
    onward = np.roll(center, -1, axis=0) - np.roll(center, 1, axis=0)
    normal = np.stack([-onward[:, 1], onward[:, 0]], axis=1) / np.hypot(*onward.T)[:, None]
    lines = [center + side * plan.width_m / 2 * normal for side in (0, 1, -1)]
    center, left, right = (np.round(np.concatenate([each, each[:1]]), _DECIMALS) for each in lines)
    track = Track(name, center, left, right, closed=True)
    return track if track.is_ccw else Track(name, center, right, left, closed=True)


def _line_along(corners: Floats, plan: _Plan, random: Random) -> Floats | None:
    """A closed line around the corners, of the length and the tightest turn of the plan.

    None if it has not come near them after some rounds.
    """
    chances = np.array([[random.random() for _ in range(3)] for _ in corners])
    waves = [random.random() for _ in range(6)]
    least_m = plan.turn_m
    for _ in range(_ROUNDS):
        arcs = _arcs(corners, chances, least_m, plan)
        if isinstance(arcs, int):
            if len(corners) == 3:
                return None
            corners, chances = (np.delete(each, arcs, axis=0) for each in (corners, chances))
            corners *= plan.length_m / length_of(corners)
            continue
        line = _smoothed(_bent(_with_arcs(corners, *arcs), plan.bent, waves), plan.smooth_m)
        longer, wider = plan.length_m / length_of(line), plan.turn_m / _tightest_m(line, 3)
        if abs(longer - 1.0) < 0.005 and 0.93 < wider < 0.985:
            return line
        corners = corners * longer
        least_m *= min(max(1.04 * wider, 0.8), 1.25)
    return None


def _arcs(
    corners: Floats, chances: Floats, least_m: float, plan: _Plan
) -> tuple[Floats, Floats] | int:
    """Radius at each corner and metres from there to its arc, or a corner that has no room."""
    ahead = np.roll(corners, -1, axis=0) - corners
    behind = np.roll(ahead, 1, axis=0)
    edge_m = np.hypot(*ahead.T)
    cross = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    angle = np.abs(np.arctan2(cross, (behind * ahead).sum(axis=1)))
    if angle.max() > _SHARPEST_RAD:
        return int(angle.argmax())
    hairpin = angle > _HAIRPIN_RAD
    clear_m = (plan.width_m + plan.gap_m) / 2 / np.sin(angle / 2)
    least = np.where(hairpin, np.maximum(least_m, clear_m), least_m)
    tangent = np.maximum(np.tan(angle / 2), 1e-6)
    room_m = edge_m - least * tangent - np.roll(least * tangent, -1)
    k = int(room_m.argmin())
    if room_m[k] < 0.0:
        following = (k + 1) % len(corners)
        return k if angle[k] < angle[following] else following

    part, wide, reach = chances.T.copy()
    both = angle + np.roll(angle, -1)
    half_turn = (cross * np.roll(cross, -1) > 0.0) & (both > 2.4) & (edge_m < 3.5 * plan.turn_m)
    part[half_turn] = 0.5
    most = least + np.minimum(part * room_m, np.roll((1.0 - part) * room_m, 1)) / tangent
    reach = np.where(wide < plan.open_share, reach, 0.25 * reach**2)
    reach[half_turn | np.roll(half_turn, 1)] = 1.0
    reach[np.argmax(np.where(hairpin, 0.0, angle))] = 0.0  # one turn is the tightest
    radius = least * (np.clip(most, least, _WIDEST_M) / least) ** reach
    return radius, radius * tangent


def _with_arcs(corners: Floats, radius: Floats, tangent_m: Floats) -> Floats:
    """The ring of straights and arcs, from the middle of the longest straight."""
    k = len(corners)
    ahead = np.roll(corners, -1, axis=0) - corners
    edge_m = np.hypot(*ahead.T)
    along = ahead / edge_m[:, None]
    straight_m = edge_m - tangent_m - np.roll(tangent_m, -1)
    start = int(straight_m.argmax())
    parts = []
    for corner in [(start + 1 + j) % k for j in range(k)]:
        u, v = along[corner - 1], along[corner]
        turn = math.atan2(u[0] * v[1] - u[1] * v[0], u @ v)
        steps = max(math.ceil(abs(turn) * radius[corner] / _STEP_M), 2)
        phi = np.linspace(0.0, abs(turn), steps + 1)[:, None]
        left = math.copysign(1.0, turn) * np.array([-u[1], u[0]])
        arc = np.sin(phi) * u + (1.0 - np.cos(phi)) * left
        parts.append(corners[corner] - tangent_m[corner] * u + radius[corner] * arc)
    middle = parts[-1][-1] + straight_m[start] / 2 * along[start]
    return np.concatenate([middle[None], *parts])


def _bent(ring: Floats, bent: float, waves: list[float]) -> Floats:
    """On ground that is pushed sideways in waves of 6 to 16 m, along each axis in turn."""
    x, y = _evenly(ring, round(length_of(ring) / _STEP_M)).T
    wave_x, wave_y, phase_x, phase_y, height_x, height_y = waves
    per_x, per_y = (2 * math.pi / (6.0 + 10.0 * wave) for wave in (wave_x, wave_y))
    x = x + _MOST_BEND * bent * height_x / per_y**2 * np.sin(per_y * y + 2 * math.pi * phase_y)
    y = y + _MOST_BEND * bent * height_y / per_x**2 * np.sin(per_x * x + 2 * math.pi * phase_x)
    return np.stack([x, y], axis=1)


def _smoothed(ring: Floats, smooth_m: float) -> Floats:
    even = _evenly(ring, round(length_of(ring) / _STEP_M))
    reach = math.ceil(3 * smooth_m / _STEP_M)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) * _STEP_M / smooth_m) ** 2)
    around = np.take(even, np.arange(-reach, len(even) + reach), axis=0, mode="wrap")
    x, y = (np.convolve(values, weight / weight.sum(), mode="valid") for values in around.T)
    return np.stack([x, y], axis=1)


def _evenly(ring: Floats, rows: int) -> Floats:
    """So many points, evenly along it; the first one stays."""
    closed = np.concatenate([ring, ring[:1]])
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    at_m = np.arange(rows) * (along_m[-1] / rows)
    return np.stack([np.interp(at_m, along_m, values) for values in closed.T], axis=1)


def _tightest_m(ring: Floats, reach: int) -> float:
    """The least radius of a circle through a point and those so many rows before and after."""
    behind, ahead = ring - np.roll(ring, reach, axis=0), np.roll(ring, -reach, axis=0) - ring
    cross = np.abs(behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0])
    sides = np.hypot(*behind.T) * np.hypot(*ahead.T) * np.hypot(*(behind + ahead).T)
    return float((sides / np.maximum(2 * cross, 1e-9)).min())


def _is_drivable(center: Floats, plan: _Plan) -> bool:
    """No turn is tighter than planned, and no stretch is too close to another one."""
    if _tightest_m(center, 1) < plan.turn_m:
        return False
    clear_m = plan.width_m + plan.gap_m
    rows = np.arange(0, len(center), max(1, round(0.2 / plan.spacing_m)))
    away = np.abs(rows[:, None] - rows)
    away_m = np.minimum(away, len(center) - away) * (plan.length_m / len(center))
    x, y = (center[rows, None] - center[rows]).transpose(2, 0, 1)
    return not (np.hypot(x, y)[away_m > math.pi / 2 * clear_m] < 0.98 * clear_m).any()
