"""Driven episodes as rows: simtrace CSV and SIM_TRACE_LOG lines.

Analysis tools define both formats: names, order, decimals and spelling.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

from drcli.exchange.trace_rows import COLUMNS, LOG_MARK, TraceRow, read_rows

CSV_HEADER = ",".join([*COLUMNS, "reward_ms"])
"""Only the last column is ours."""

STATUS_LABELS = {
    "lap_complete": "Lap complete",
    "off_track": "Off track",
    "crashed": "Crashed",
    "immobilized": "Immobilized",
    "reversed": "Reversed",
    "in_progress": "In progress",
    "pause": "Pause",
    "prepare": "Prepare",
    "park": "Park",
    "time_up": "Time Up",
    "discarded": "Discarded",
}
VIOLATIONS = ("crashed", "immobilized", "off_track", "reversed")
STEP_S = 1.0 / 15.0
"""Simulated time of one step, seconds.

Rows are stamped at the end of their step; the first, `prepare`, is the step of the reset. So an
episode begins a step before its first row, as in the reference's metrics. In a race without a stop,
a later lap begins at the last row of the one before.
"""

Phase = Literal["training", "evaluation"]


@dataclass(frozen=True, slots=True)
class Row:
    """One step of one car.

    Attributes:
        steps: From 1, `prepare`.
        x: Of the point 0.14 m ahead of the origin, metres; so is `y`.
        yaw_deg: In [-180, 180].
        steering_deg: Requested, left positive.
        speed_mps: Requested.
        action: Index, or "[steering speed]".
        status: A key of `STATUS_LABELS`.
        pause_s: Rest of a penalty.
        time_s: Simulated, since the reset.
        reward_ms: Wall time of the reward function, so not compared.
    """

    steps: int
    x: float
    y: float
    yaw_deg: float
    steering_deg: float
    speed_mps: float
    action: str
    reward: float
    done: bool
    all_wheels_on_track: bool
    progress: float
    closest_waypoint: int
    status: str
    pause_s: float
    time_s: float
    crashes: int = 0
    reward_ms: float = field(default=0.0, compare=False)


@dataclass
class Episode:
    """A whole episode, from `prepare` to its end.

    Attributes:
        number: From 0; trials begin at 0 again.
        clock_s: Simulation clock at its reset, as if episodes followed one another.
    """

    number: int
    phase: Phase
    rows: list[Row] = field(default_factory=list)
    clock_s: float = 0.0
    begin_s: float = 0.0

    @property
    def reward(self) -> float:
        return sum(row.reward for row in self.rows)

    @property
    def progress(self) -> float:
        return self.rows[-1].progress

    @property
    def status(self) -> str:
        return self.rows[-1].status

    @property
    def completed(self) -> bool:
        return self.status == "lap_complete"

    @property
    def discarded(self) -> bool:
        """Declared broken by the reward function: not learned from."""
        return self.status == "discarded"

    @property
    def duration_s(self) -> float:
        return self.rows[-1].time_s - self.begin_s

    @property
    def steps(self) -> int:
        return len(self.rows) - 1


def steering_changes(episodes: Iterable[Episode]) -> tuple[int, float]:
    """Changes of the steering's side (straight is not one), and metres."""
    changes, metres = 0, 0.0
    for episode in episodes:
        side = 0.0
        for before, row in pairwise(episode.rows):
            metres += math.hypot(row.x - before.x, row.y - before.y)
            if row.steering_deg:
                changes += side * row.steering_deg < 0.0
                side = math.copysign(1.0, row.steering_deg)
    return changes, metres


def schedule(episodes: Iterable[Episode], clock_s: float) -> float:
    """Set `clock_s` of parallel episodes as if one followed the other."""
    for episode in episodes:
        episode.clock_s = clock_s
        clock_s += episode.duration_s + STEP_S
    return clock_s


def csv_text(
    episodes: Iterable[Episode], track_length_m: float, wall_clock: tuple[float, float]
) -> str:
    """A simtrace file.

    Cars drive in parallel, so the rows share the `wall_clock` (Unix seconds) equally: analysis
    tools then compute the right real-time factor.
    """
    rows = [(episode, row) for episode in episodes for row in episode.rows]
    begin, end = wall_clock
    per_row = (end - begin) / max(len(rows), 1)
    lines = [
        ",".join(_fields(episode, row, track_length_m, begin + per_row * (i + 1)))
        for i, (episode, row) in enumerate(rows)
    ]
    return "\n".join([CSV_HEADER, *lines, ""])


def _fields(episode: Episode, row: Row, track_length_m: float, wall_clock: float) -> list[str]:
    return [
        str(episode.number),
        f"{float(row.steps)}",
        str(row.x),
        str(row.y),
        str(row.yaw_deg),
        str(row.steering_deg),
        str(row.speed_mps),
        row.action,
        str(row.reward),
        str(row.done),
        str(row.all_wheels_on_track),
        str(row.progress),
        str(row.closest_waypoint),
        str(track_length_m),
        str(episode.clock_s + row.time_s),
        row.status,
        str(row.pause_s),
        str(row.crashes),
        str(wall_clock),
        str(round(row.reward_ms, 3)),
    ]


def log_lines(episode: Episode, track_length_m: float, wall_clock: float) -> str:
    return "\n".join(
        f"{LOG_MARK}{episode.number},{row.steps},{row.x:.4f},{row.y:.4f},{row.yaw_deg:.4f},"
        f"{row.steering_deg:.2f},{row.speed_mps:.2f},{row.action},{row.reward:.4f},{row.done},"
        f"{row.all_wheels_on_track},{_progress(row)},{row.closest_waypoint},"
        f"{track_length_m:.2f},{episode.clock_s + row.time_s},{row.status},{row.pause_s:.2f},"
        f"{row.crashes},{wall_clock:.4f}"
        for row in episode.rows
    )


def _progress(row: Row) -> str:
    """Never 0.0000 at the end of an episode: log-guru divides by it."""
    text = f"{row.progress:.4f}"
    return "0.0001" if row.done and float(text) == 0.0 else text


@dataclass(frozen=True)
class TracedEpisode:
    """As `Episode`, from a simtrace; `wall_s` is Unix time of its first and last row."""

    number: int
    steps: int
    reward: float
    progress: float
    status: str
    clock_s: float
    duration_s: float
    wall_s: tuple[float, float]
    phase: Phase = "training"


def read_csv(data: bytes) -> list[TracedEpisode]:
    episodes: dict[int, list[TraceRow]] = {}
    for row in read_rows(data).rows:
        if math.isfinite(row.reward + row.wall_s) and row.status in STATUS_LABELS:
            episodes.setdefault(row.episode, []).append(row)
    return [
        TracedEpisode(
            number=number,
            steps=len(rows) - 1,
            reward=sum(row.reward for row in rows),
            progress=rows[-1].progress,
            status=rows[-1].status,
            clock_s=rows[0].time_s - STEP_S,
            duration_s=rows[-1].time_s - rows[0].time_s + STEP_S,
            wall_s=(rows[0].wall_s, rows[-1].wall_s),
        )
        for number, rows in episodes.items()
        if len(rows) > 1
    ]
