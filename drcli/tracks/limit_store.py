"""Fastest lines of cars on tracks.

A fingerprint of its content joins a route file to its limit. Limits hold no point of the track:
only offsets, speeds and times at stations along the centre line.
"""

import hashlib
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from drcli.base.installation import lazy_imports

with lazy_imports():
    import numpy as np

SHIPPED = Path(__file__).with_name("limits.npz")
"""From `scripts/compute_limits.py`."""

SOLVER_VERSION = 1
WITHIN = 1.03
"""A computed lap is the limit once driven within this factor."""

_DIGITS = 4
"""A tenth of a millimetre."""


class LimitKey(NamedTuple):
    route: str
    reverse: bool
    car: str


@dataclass(frozen=True)
class StoredLimit:
    """A computed lap, and what the simulated car drove of it.

    Attributes:
        reverse: Against the rows of the route file.
        driven_s: By the predictive driver, or None.
        standing_s: Its lap from rest, as in an episode.
        offset_mm: Left of the centre line, at each station.
        length_m: Of the centre line.
    """

    route: str
    reverse: bool
    car: str
    world: str
    computed_s: float
    driven_s: float | None
    standing_s: float | None
    seed: int
    version: int
    length_m: float
    offset_mm: tuple[int, ...]
    speed_mmps: tuple[int, ...]
    clock_ms: tuple[int, ...]

    @property
    def key(self) -> LimitKey:
        return LimitKey(self.route, self.reverse, self.car)

    @property
    def validated(self) -> bool:
        if self.driven_s is None:
            return False
        return self.computed_s <= self.driven_s <= WITHIN * self.computed_s


def fingerprint(file: Path) -> str:
    """Of a .npy's numbers, or other files' bytes; raises OSError, ValueError."""
    if file.suffix != ".npy":
        return hashlib.sha256(file.read_bytes()).hexdigest()[:16]

    rows = np.load(file, allow_pickle=False).astype(np.float64).round(_DIGITS) + 0.0
    return hashlib.sha256(rows.tobytes()).hexdigest()[:16]


def write_limits(file: Path, limits: Iterable[StoredLimit]) -> None:
    kept = sorted(limits, key=lambda limit: limit.key)
    columns = ("offset_mm", "speed_mmps", "clock_ms")
    heads = []
    for limit in kept:
        head = {name: value for name, value in asdict(limit).items() if name not in columns}
        heads.append({**head, "stations": len(limit.offset_mm)})
    arrays: dict[str, Any] = {
        name: np.concatenate([np.array(getattr(limit, name), np.int32) for limit in kept])
        for name in columns
    }
    # Times rise, and their steps are small numbers, which pack better.
    arrays["clock_ms"] = np.diff(arrays["clock_ms"], prepend=0)
    unfinished = file.with_name(f".{file.name}")
    with unfinished.open("wb") as stream:
        np.savez_compressed(
            stream,
            heads=np.frombuffer(json.dumps(heads).encode(), np.uint8),
            **{name: values.astype(np.int32) for name, values in arrays.items()},
        )
    unfinished.replace(file)


def read_limits(file: Path) -> Mapping[LimitKey, StoredLimit]:
    """Empty without a readable file."""
    try:
        changed = file.stat().st_mtime_ns
    except OSError:
        return {}
    return _read(file, changed)


@lru_cache(maxsize=4)
def _read(file: Path, changed: int) -> Mapping[LimitKey, StoredLimit]:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            heads = json.loads(stored["heads"].tobytes())
            offsets, speeds = stored["offset_mm"].tolist(), stored["speed_mmps"].tolist()
            clocks = np.cumsum(stored["clock_ms"]).tolist()
        found, first = {}, 0
        for head in heads:
            last = first + head.pop("stations")
            rows = slice(first, last)
            limit = StoredLimit(
                **head,
                offset_mm=tuple(offsets[rows]),
                speed_mmps=tuple(speeds[rows]),
                clock_ms=tuple(clocks[rows]),
            )
            found[limit.key] = limit
            first = last
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):  # damaged: as if absent
        return {}
    return found
