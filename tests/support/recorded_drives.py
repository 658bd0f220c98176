"""Simtraces of drives that nobody drove: along the centre line of a track, at an even speed."""

import numpy as np

from drcli.records.trace import CSV_HEADER
from drsim.car.car import REFERENCE_POINT_AHEAD_M
from drsim.track.track import Track


def trace_rows(
    track: Track,
    *,
    episode: int = 0,
    rows: int = 31,
    step_s: float = 1.0 / 15.0,
    speed_mps: float = 1.5,
    status: str = "in_progress",
    clock_s: float = 100.0,
) -> list[dict[str, str]]:
    """Rows of one episode, column by column as in a trace."""
    along = np.arange(rows) * step_s * speed_mps
    poses = track.pose_at(along % track.length_m)
    found = []
    for k, (x, y, yaw) in enumerate(poses.tolist()):
        last = k == rows - 1
        values = (
            episode,
            float(k + 1),
            x + REFERENCE_POINT_AHEAD_M * np.cos(yaw),
            y + REFERENCE_POINT_AHEAD_M * np.sin(yaw),
            np.degrees(yaw),
            10.0,
            speed_mps,
            1,
            0.5,
            last,
            True,
            100.0 * along[k] / track.length_m,
            k,
            track.length_m,
            clock_s + k * step_s,
            "prepare" if k == 0 else status if last else "in_progress",
            0.0,
            0,
            1.7e9 + k,
            0.0 if k == 0 else 0.004,
        )
        found.append(dict(zip(CSV_HEADER.split(","), map(str, values), strict=True)))
    return found


def trace_csv(*episodes: list[dict[str, str]], without: tuple[str, ...] = ()) -> bytes:
    """A simtrace of these episodes, maybe without some columns."""
    names = [name for name in CSV_HEADER.split(",") if name not in without]
    lines = [",".join(row[name] for name in names) for rows in episodes for row in rows]
    return "\n".join([",".join(names), *lines, ""]).encode()
