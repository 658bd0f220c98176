"""Generated circuits: `zoo-17` is the same track bit for bit wherever it is made.

A circuit begins as a short tour through scattered points. Each of its corners becomes an arc, the
line is smoothed, and what comes too close to itself is thrown away. Ranges follow the reference
simulator's 126 loops, and go a little beyond.
"""

import math
import re
from dataclasses import dataclass
from random import Random

import numpy as np

from drsim.arrays import Floats
from drsim.errors import TrackError
from drsim.track.track import Track

_NAME = re.compile(r"zoo-(0|[1-9][0-9]{0,6})")

LENGTHS_M, WIDTHS_M, TURNS_M = (8.0, 150.0), (0.4, 3.0), (0.3, 10.0)
"""What `generate` accepts: length of the centre line, width of the road, least radius."""

_TRIES = 60
_STEP_M = 0.05
_INNER_M = 0.08
"""Least radius of the inner border."""

_SHARPEST_RAD = math.radians(160.0)
_DECIMALS = 4


@dataclass(frozen=True)
class _Plan:
    """What a circuit is to be like.

    Attributes:
        gap_m: Least ground between two stretches of road.
        corner_m: Between corners of the tour, about.
        stretch: Width over height of the ground.
        open_share: Of the corners that turn as wide as they can, rather than as tight.
        smooth_m: Standard deviation of the smoothing along the line.
        waving: Share by which the width varies along the lap.
    """

    length_m: float
    width_m: float
    turn_m: float
    gap_m: float
    corner_m: float
    stretch: float
    open_share: float
    smooth_m: float
    spacing_m: float
    waving: float = 0.0


def number_of(world: str) -> int | None:
    """The number of a generated circuit; None for any other name."""
    found = _NAME.fullmatch(world)
    return None if found is None else int(found.group(1))


def circuit(number: int) -> Track:
    """The track `zoo-N`."""
    random = Random(number)
    while True:
        plan = _drawn(random)
        for _ in range(_TRIES):
            track = _built(f"zoo-{number}", plan, random)
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
    for text, value, (low, high) in (
        ("length_m", length_m, LENGTHS_M),
        ("width_m", width_m, WIDTHS_M),
        ("turn_m", turn_m, TURNS_M),
    ):
        if value is not None and not low <= value <= high:
            raise TrackError(
                f"{text} {value:g} is outside {low:g} .. {high:g} m. Choose a value within."
            )
    random = Random(seed)
    for _ in range(5 * _TRIES):
        track = _built(name, _drawn(random, length_m, width_m, turn_m), random)
        if track is not None:
            return track
    asked = {"length_m": length_m, "width_m": width_m, "turn_m": turn_m}
    words = ", ".join(f"{key} {value:g}" for key, value in asked.items() if value is not None)
    raise TrackError(
        f"no drivable loop with {words} was found. Give a greater length_m, or a smaller "
        "width_m or turn_m."
    )


def _drawn(
    random: Random,
    length_m: float | None = None,
    width_m: float | None = None,
    turn_m: float | None = None,
) -> _Plan:
    def between(low: float, high: float) -> float:
        return low + (high - low) * random.random()

    def scaled(low: float, high: float) -> float:
        return low * math.exp(math.log(high / low) * random.random())

    length = length_m or scaled(14.0, 75.0)
    usual = random.random() < 0.5
    width = width_m or (1.07 if usual else between(0.6, 1.1 if length < 30.0 else 1.5))
    turn = turn_m or max(scaled(0.5, 1.3), width / 2 + _INNER_M)
    gap = between(0.35, 1.2)
    return _Plan(
        length_m=length,
        width_m=width,
        turn_m=turn,
        gap_m=gap,
        corner_m=max(scaled(2.2, 6.0), width + gap),
        stretch=scaled(1.0, 2.2),
        open_share=random.random(),
        smooth_m=turn * between(0.1, 0.4),
        spacing_m=(0.15, 0.2, 0.25, 0.3)[int(4 * random.random())],
    )


def _built(name: str, plan: _Plan, random: Random) -> Track | None:
    """None if it cannot be driven."""
    corners = _tour(plan, random)
    line = _rounded(corners, plan, random) if len(corners) >= 3 else None
    if line is None:
        return None
    rows = round(plan.length_m / plan.spacing_m)
    center = _evenly(line, rows)
    center *= plan.length_m / _length(center)
    if random.random() < 0.5:
        center = center[::-1]
    center = np.round(center - center.min(axis=0) + plan.width_m, _DECIMALS)
    if not _is_drivable(center, plan):
        return None
    onward = np.roll(center, -1, axis=0) - np.roll(center, 1, axis=0)
    normal = np.stack([-onward[:, 1], onward[:, 0]], axis=1) / np.hypot(*onward.T)[:, None]
    left, right = (
        np.round(center + side * plan.width_m / 2 * normal, _DECIMALS) for side in (1, -1)
    )
    center, left, right = (np.concatenate([each, each[:1]]) for each in (center, left, right))
    track = Track(name, center, left, right, closed=True)
    return track if track.is_ccw else Track(name, center, right, left, closed=True)


def _tour(plan: _Plan, random: Random) -> Floats:
    """A short tour through scattered points. Shape (k, 2)."""
    count = max(3, round(plan.length_m / plan.corner_m / 1.1))
    height = plan.corner_m * math.sqrt(1.4 * count / plan.stretch)
    points: list[tuple[float, float]] = []
    for _ in range(40 * count):
        x, y = plan.stretch * height * random.random(), height * random.random()
        if all(math.hypot(x - u, y - v) > plan.corner_m for u, v in points):
            points.append((x, y))
            if len(points) == count:
                break
    corners = np.array(points)
    return _uncrossed(corners[np.argsort([random.random() for _ in points])])


def _uncrossed(corners: Floats) -> Floats:
    """In another order, which no exchange of two edges makes shorter; no such tour crosses."""
    k = len(corners)
    while True:
        after = np.roll(corners, -1, axis=0)
        apart = np.hypot(*(corners[:, None] - corners).transpose(2, 0, 1))
        apart_after = np.hypot(*(after[:, None] - after).transpose(2, 0, 1))
        step = np.hypot(*(after - corners).T)
        gain = np.triu(step[:, None] + step - apart - apart_after, 1)
        first, second = divmod(int(np.argmax(gain)), k)
        if gain[first, second] < 1e-6:
            return corners
        corners[first + 1 : second + 1] = corners[first + 1 : second + 1][::-1]


def _rounded(corners: Floats, plan: _Plan, random: Random) -> Floats | None:
    """The tour as a line with a point every few centimetres, scaled to the length of the plan."""
    wide = [random.random() for _ in range(len(corners))]
    reach = [random.random() for _ in range(len(corners))]
    share = [random.random() for _ in range(len(corners))]
    corners = corners * (plan.length_m / _length(corners))
    for _ in range(12):
        arcs = _arcs(corners, plan, wide, reach, share)
        if isinstance(arcs, int):  # its edge is too short: leave the corner out
            if len(corners) == 3:
                return None
            corners = np.delete(corners, arcs, axis=0)
            for values in (wide, reach, share):
                del values[arcs]
            corners = corners * (plan.length_m / _length(corners))
            continue
        line = _drawn_line(corners, *arcs)
        length = _length(line)
        if abs(length / plan.length_m - 1.0) < 0.01:
            return _smoothed(line * (plan.length_m / length), plan.smooth_m)
        corners = corners * (plan.length_m / length)
    return None


def _arcs(
    corners: Floats, plan: _Plan, wide: list[float], reach: list[float], share: list[float]
) -> tuple[Floats, Floats] | int:
    """Radius at each corner and metres from there to its arc; or a corner that has no room."""
    ahead = np.roll(corners, -1, axis=0) - corners
    edge = np.hypot(*ahead.T)
    behind = np.roll(ahead, 1, axis=0)
    cross = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    angle = np.abs(np.arctan2(cross, (behind * ahead).sum(axis=1)))
    sharpest = int(np.argmax(angle))
    if angle[sharpest] > _SHARPEST_RAD:
        return sharpest
    tangent = np.tan(angle / 2)
    least = np.full(len(corners), 1.04 * plan.turn_m)
    hairpin = angle > 2.0
    least[hairpin] = np.maximum(
        least[hairpin], (plan.width_m + plan.gap_m) / 2 / np.sin(angle[hairpin] / 2)
    )
    room = edge - least * tangent - np.roll(least * tangent, -1)
    tightest = int(np.argmin(room))
    if room[tightest] < 0.0:
        following = (tightest + 1) % len(corners)
        return tightest if angle[tightest] < angle[following] else following
    part = np.array(share)
    most = least + np.minimum(part * room, np.roll((1.0 - part) * room, 1)) / np.maximum(
        tangent, 1e-6
    )
    most = np.minimum(most, 12.0)
    openness = np.array(reach)
    openness = np.where(np.array(wide) < plan.open_share, openness, 0.25 * openness**2)
    openness[np.argmax(np.where(hairpin, 0.0, angle))] = 0.0  # one turn is the tightest
    radius = least * (most / least) ** openness
    return radius, radius * tangent


def _drawn_line(corners: Floats, radius: Floats, tangent_m: Floats) -> Floats:
    """Straights and arcs, from the middle of the longest straight."""
    k = len(corners)
    ahead = np.roll(corners, -1, axis=0) - corners
    edge = np.hypot(*ahead.T)
    along = ahead / edge[:, None]
    straight = edge - tangent_m - np.roll(tangent_m, -1)
    start = int(np.argmax(straight))
    parts = []
    for corner in [(start + 1 + j) % k for j in range(k)]:
        u, v = along[corner - 1], along[corner]
        r, t = radius[corner], tangent_m[corner]
        turn = math.atan2(u[0] * v[1] - u[1] * v[0], u @ v)
        steps = max(int(abs(turn) * r / _STEP_M), 2)
        phi = np.linspace(0.0, abs(turn), steps + 1)
        left = math.copysign(1.0, turn) * np.array([-u[1], u[0]])
        begin = corners[corner] - t * u
        parts.append(begin + r * (np.sin(phi)[:, None] * u + (1.0 - np.cos(phi))[:, None] * left))
    middle = parts[-1][-1] + straight[start] / 2 * along[start]
    return np.concatenate([middle[None], *parts])


def _smoothed(line: Floats, smooth_m: float) -> Floats:
    """A closed line with points `_STEP_M` apart, as if seen through a soft lens along it."""
    even = _evenly(line, round(_length(line) / _STEP_M))
    reach = min(math.ceil(3 * smooth_m / _STEP_M), len(even) // 2)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) * _STEP_M / smooth_m) ** 2)
    weight /= weight.sum()
    around = np.concatenate([even[-reach:], even, even[:reach]])
    return np.stack([np.convolve(values, weight, mode="valid") for values in around.T], axis=1)


def _evenly(line: Floats, rows: int) -> Floats:
    """A closed line, with as many points, evenly along it; the first one stays."""
    ring = np.concatenate([line, line[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    at = np.arange(rows) * (along[-1] / rows)
    return np.stack([np.interp(at, along, values) for values in ring.T], axis=1)


def _length(line: Floats) -> float:
    return float(np.hypot(*(np.roll(line, -1, axis=0) - line).T).sum())


def _is_drivable(center: Floats, plan: _Plan) -> bool:
    """No turn is tighter than planned, and no stretch comes too close to another one."""
    behind = center - np.roll(center, 1, axis=0)
    ahead = np.roll(behind, -1, axis=0)
    cross = np.abs(behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0])
    chord = np.hypot(*(behind + ahead).T)
    # The radius of the circle through three waypoints.
    product = np.hypot(*behind.T) * np.hypot(*ahead.T) * chord
    if (product < 2 * plan.turn_m * cross).any():
        return False
    clear_m = plan.width_m + plan.gap_m
    rows = len(center)
    thin = max(1, round(0.2 / plan.spacing_m))
    index = np.arange(0, rows, thin)
    points = center[index]
    away = np.abs(index[:, None] - index)
    away_m = np.minimum(away, rows - away) * (plan.length_m / rows)
    apart = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    return not (apart[away_m > math.pi / 2 * clear_m] < 0.98 * clear_m).any()
