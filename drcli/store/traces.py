"""What a training trace in the bucket tells of its episodes, where nothing else does any more."""

import csv
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from drcli.store import keys
from drcli.store.bucket import Bucket

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
}
"""How metrics files spell the status words of traces."""

_TRACE = re.compile(r"(?:(\d+)/)?training-simtrace/(\d+)-iteration\.csv")


@dataclass(frozen=True)
class TracedEpisode:
    """One episode as its trace has it.

    Attributes:
        number: Counted from 0.
        steps: In which the policy drove.
        reward: Sum of its rewards.
        progress: Percent of the lap at its end.
        status: How it ended, in the words of the trace.
        begin_s: Simulation clock at its start.
        end_s: Simulation clock at its end.
        wall_s: Unix seconds of its first and last row.
    """

    number: int
    steps: int
    reward: float
    progress: float
    status: str
    begin_s: float
    end_s: float
    wall_s: tuple[float, float]

    @property
    def duration_s(self) -> float:
        """Simulated seconds it lasted."""
        return self.end_s - self.begin_s


def traced_iterations(bucket: Bucket, prefix: str) -> dict[int, dict[int, str]]:
    """Keys of the training traces of a model, by iteration and worker."""
    start = keys.folder(prefix)
    found: dict[int, dict[int, str]] = {}
    for info in bucket.list(start):
        match = _TRACE.fullmatch(info.key.removeprefix(start))
        if match is not None:
            found.setdefault(int(match[2]), {})[int(match[1] or 0)] = info.key
    return dict(sorted(found.items()))


def read_trace(bucket: Bucket, key: str) -> list[TracedEpisode]:
    """The episodes of a trace, in its order; those whose rows cannot be read are left out."""
    lines = bucket.get(key).decode("utf-8", "replace").replace("\0", "").splitlines()
    rows: dict[int, list[_Row]] = {}
    for row in _rows(lines):
        rows.setdefault(row.episode, []).append(row)
    return [_episode(number, of) for number, of in rows.items() if len(of) > 1]


@dataclass(frozen=True)
class _Row:
    episode: int
    reward: float
    progress: float
    status: str
    time_s: float
    wall_s: float


def _rows(lines: list[str]) -> Iterator[_Row]:
    for fields in csv.DictReader(lines):
        try:
            row = _Row(
                episode=int(fields["episode"]),
                reward=float(fields["reward"]),
                progress=float(fields["progress"]),
                status=fields["episode_status"],
                time_s=float(fields["tstamp"]),
                wall_s=float(fields["wall_clock"]),
            )
        except (KeyError, TypeError, ValueError):
            continue
        numbers = (row.reward, row.progress, row.time_s, row.wall_s)
        if all(map(math.isfinite, numbers)) and row.status in STATUS_LABELS:
            yield row


def _episode(number: int, rows: list[_Row]) -> TracedEpisode:
    first, last = rows[0], rows[-1]
    return TracedEpisode(
        number=number,
        steps=len(rows) - 1,
        reward=sum(row.reward for row in rows),
        progress=last.progress,
        status=last.status,
        begin_s=first.time_s,
        end_s=last.time_s,
        wall_s=(first.wall_s, last.wall_s),
    )
