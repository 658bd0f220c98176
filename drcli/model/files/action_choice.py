"""Chooses discrete actions: a grid, those that a lap needs, or those used."""

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

from drcli.base.errors import SettingsError
from drcli.base.report import Col
from drcli.model.files.action_space import MANY_ACTIONS, USUAL, Pair
from drcli.records.trace import LOG_MARK, STEP_S, TraceRow, read_rows

STEERING_UNIT_DEG = 5.0
SPEED_UNIT_MPS = 0.25
"""A smaller difference hardly changes the lap: it is close."""

CLOSE_SHARE = 0.95
"""Of the steps with a close action, if the number is not given."""

_MOST_ROUNDS = 100
_ROUND_DEG, _ROUND_MPS = 0.5, 0.05


@dataclass(frozen=True)
class ChosenAction:
    """An action of a list."""

    steering_angle: Annotated[float, "Degrees, left positive.", Col("steering", "{:g}°")]
    speed: Annotated[float, "m/s.", Col("speed", "{:g} m/s")]
    share: Annotated[
        float | None,
        "Share of the driven steps that it stands for, 0 .. 1; None without a drive.",
        Col("share", "{:.0%}", none=""),
    ] = None


def grid(angles: int, speeds: int, *, max_angle: float, max_speed: float) -> list[ChosenAction]:
    """Every angle with every speed (degrees, m/s), as the DeepRacer console generates them."""
    if angles == 1:
        degrees = [0.0]
    else:
        degrees = [max_angle * (2 * k / (angles - 1) - 1) for k in range(angles)]
    rising = [max_speed * (k + 1) / speeds for k in range(speeds)]
    return [ChosenAction(_short(angle), _short(speed)) for angle in degrees for speed in rising]


def smoothed(pairs: Sequence[Pair], steps: int) -> list[Pair]:
    """Means over `steps`: what the wheels make of the requests."""
    half = (steps - 1) // 2
    means = []
    for k in range(len(pairs)):
        near = pairs[max(k - half, 0) : k + half + 1]
        means.append(
            (math.fsum(p[0] for p in near) / len(near), math.fsum(p[1] for p in near) / len(near))
        )
    return means


def needed(pairs: Sequence[Pair], count: int | None) -> list[ChosenAction]:
    """The few actions that stand for a lap's requests with the smallest squared error.

    k-means in units of `STEERING_UNIT_DEG` and `SPEED_UNIT_MPS`. It begins with the mean and adds
    the request furthest from all actions, so it is deterministic. `count` None: to reach
    `CLOSE_SHARE`.
    """
    points = [(angle / STEERING_UNIT_DEG, speed / SPEED_UNIT_MPS) for angle, speed in pairs]
    if count is not None:
        return _actions(points, _centers(points, min(count, len(set(points)))))
    for several in range(1, MANY_ACTIONS + 1):
        actions = _actions(points, _centers(points, min(several, len(set(points)))))
        if close_share(pairs, actions) >= CLOSE_SHARE:
            break
    return actions


def used(pairs: Sequence[Pair], *, angles: int, speeds: int, least: float) -> list[ChosenAction]:
    """Cells of a histogram of the requests.

    At most `angles * speeds` different requests count as they are, others as means of even cells.

    Raises:
        SettingsError: No cell has the share `least`.
    """
    counts = Counter(pairs)
    if len(counts) > angles * speeds:
        cells: dict[tuple[int, int], list[Pair]] = {}
        limits = [(min(values), max(values)) for values in zip(*counts, strict=True)]
        for pair in pairs:
            cell = _cell(pair[0], limits[0], angles), _cell(pair[1], limits[1], speeds)
            cells.setdefault(cell, []).append(pair)
        counts = Counter()
        for inside in cells.values():
            counts[_rounded(*_mean(inside))] += len(inside)
    kept = {pair: number for pair, number in counts.items() if number >= least * len(pairs)}
    if not kept:
        raise SettingsError(
            f"No action has a share of {least:.1%} of the {len(pairs)} steps.",
            remedy="Choose a smaller share with --least, or fewer cells.",
        )
    return [
        ChosenAction(_short(angle), _short(speed), number / len(pairs))
        for (angle, speed), number in sorted(kept.items())
    ]


def close_share(pairs: Sequence[Pair], actions: Sequence[ChosenAction]) -> float:
    """Within one unit of steering and of speed, 0 .. 1."""
    close = sum(
        any(
            abs(angle - action.steering_angle) <= STEERING_UNIT_DEG
            and abs(speed - action.speed) <= SPEED_UNIT_MPS
            for action in actions
        )
        for angle, speed in pairs
    )
    return close / len(pairs)


def _centers(points: Sequence[Pair], count: int) -> list[Pair]:
    centers = [_mean(points)]
    while len(centers) < count:
        centers.append(max(points, key=lambda point: min(_apart(point, c) for c in centers)))
    for _ in range(_MOST_ROUNDS):
        groups: list[list[Pair]] = [[] for _ in centers]
        for point in points:
            groups[_nearest(point, centers)].append(point)
        moved = [_mean(group) if group else c for group, c in zip(groups, centers, strict=True)]
        if moved == centers:
            break
        centers = moved
    return centers


def _actions(points: Sequence[Pair], centers: Sequence[Pair]) -> list[ChosenAction]:
    counts = Counter(_nearest(point, centers) for point in points)
    shares: Counter[Pair] = Counter()
    for number, (angle, speed) in enumerate(centers):
        if counts[number]:
            shares[_rounded(angle * STEERING_UNIT_DEG, speed * SPEED_UNIT_MPS)] += counts[number]
    return [
        ChosenAction(angle, speed, number / len(points))
        for (angle, speed), number in sorted(shares.items())
    ]


def _rounded(angle_deg: float, speed_mps: float) -> Pair:
    slowest = USUAL["speed"][0]
    return (
        _short(round(angle_deg / _ROUND_DEG) * _ROUND_DEG),
        _short(max(round(speed_mps / _ROUND_MPS) * _ROUND_MPS, slowest)),
    )


def _short(value: float) -> float:
    return round(value, 2) + 0.0


def _nearest(point: Pair, centers: Sequence[Pair]) -> int:
    return min(range(len(centers)), key=lambda number: _apart(point, centers[number]))


def _apart(one: Pair, other: Pair) -> float:
    return (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2


def _mean(pairs: Sequence[Pair]) -> Pair:
    return (
        math.fsum(pair[0] for pair in pairs) / len(pairs),
        math.fsum(pair[1] for pair in pairs) / len(pairs),
    )


def _cell(value: float, limits: tuple[float, float], count: int) -> int:
    low, high = limits
    if high <= low:
        return 0
    return min(int((value - low) / (high - low) * count), count - 1)


# Driven actions, from simtraces and logs.


_STANDING = ("prepare", "pause", "manual_pause", "park")
"""The car ignores its action."""

_LONGEST_STEP_S = 2.0


@dataclass(frozen=True, slots=True)
class DrivenStep:
    """One step that was driven.

    Attributes:
        pair: Requested, within the car's limits.
        time_s: Since some start; may be NaN.
        status: In small letters.
    """

    episode: int
    pair: Pair
    progress: float
    time_s: float
    status: str


@dataclass(frozen=True)
class DrivenLap:
    """Without leaving the track."""

    file: str
    episode: int
    seconds: float
    pairs: tuple[Pair, ...]


@dataclass(frozen=True)
class DrivenFile:
    name: str
    steps: tuple[DrivenStep, ...]
    skipped: int


def read_steps(data: bytes, name: str) -> DrivenFile:
    """Skips unreadable lines; SettingsError without any step."""
    found = read_rows(data)
    driven = [row for row in found.rows if math.isfinite(_sum(row))]
    steps = [_step(row) for row in driven if row.status not in _STANDING]
    skipped = len(found.damaged) + len(found.rows) - len(driven)
    if not steps:
        what = "has no driven step" if driven or not skipped else "is not a trace of a drive"
        raise SettingsError(
            f"{name} {what}.",
            remedy="Name a file such as training-simtrace/12-iteration.csv, or a log with "
            f"lines that begin with {LOG_MARK}",
        )
    return DrivenFile(name, tuple(steps), skipped)


def complete_laps(files: Iterable[DrivenFile]) -> list[DrivenLap]:
    laps = [lap for file in files for part in _laps(file.steps) if (lap := _lap(file, part))]
    return sorted(laps, key=lambda lap: lap.seconds)


def _sum(row: TraceRow) -> float:
    return row.steering_deg + row.speed_mps + row.progress


def _step(row: TraceRow) -> DrivenStep:
    (low_deg, high_deg), (slow, fast) = USUAL["steering_angle"], USUAL["speed"]
    pair = min(max(row.steering_deg, low_deg), high_deg), min(max(row.speed_mps, slow), fast)
    return DrivenStep(row.episode, pair, row.progress, row.time_s, row.status)


def _laps(steps: tuple[DrivenStep, ...]) -> Iterator[list[DrivenStep]]:
    """A race of several laps has them in one episode."""
    part: list[DrivenStep] = []
    for step in steps:
        last = part[-1] if part else step
        if step.episode != last.episode or step.progress < last.progress - 50.0:
            yield part
            part = []
        part.append(step)
        if step.status != "in_progress":
            yield part
            part = []
    yield part


def _lap(file: DrivenFile, part: list[DrivenStep]) -> DrivenLap | None:
    if len(part) < 10 or part[0].progress > 5.0:
        return None
    end = part[-1]
    if end.status != "lap_complete" and (end.status != "in_progress" or end.progress < 99.9):
        return None
    gaps = [after.time_s - before.time_s for before, after in itertools.pairwise(part)]
    told = all(0.0 < gap < _LONGEST_STEP_S for gap in gaps)  # False for NaN, too
    seconds = sum(gaps) + STEP_S if told else len(part) * STEP_S
    pairs = tuple(step.pair for step in part)
    return DrivenLap(file.name, part[0].episode, seconds, pairs)
