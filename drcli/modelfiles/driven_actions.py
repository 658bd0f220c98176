"""Driven actions, from simtraces and logs."""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from drcli.base.errors import SettingsError
from drcli.exchange.trace_rows import LOG_MARK, TraceRow, read_rows
from drcli.modelfiles.action_space import USUAL, Pair

_STANDING = ("prepare", "pause", "manual_pause", "park")
"""The car ignores its action."""

_STEP_S = 1.0 / 15.0
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
    seconds = sum(gaps) + _STEP_S if told else len(part) * _STEP_S
    pairs = tuple(step.pair for step in part)
    return DrivenLap(file.name, part[0].episode, seconds, pairs)
