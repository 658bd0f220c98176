"""Files with the fastest lines of cars on tracks: what is shipped, and what a racer computed.

A limit belongs to a route file by a fingerprint of its content, so a changed file has none. It
holds no point of the track: only offsets, speeds and times at stations along the centre line.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

SHIPPED = Path(__file__).with_name("limits.npz")
"""Limits of the community's routes and of ours; `scripts/compute_limits.py` writes them."""

SOLVER_VERSION = 1
"""Changes when computed laps do."""

WITHIN = 1.03
"""A computed lap is called the limit once the simulated car drove within this factor of it."""

_DIGITS = 4
"""Route files are compared to a tenth of a millimetre."""


class LimitKey(NamedTuple):
    """Which lap: the route, whether against the order of its rows, and the car's set."""

    route: str
    reverse: bool
    car: str


@dataclass(frozen=True)
class StoredLimit:
    """A computed lap, and what the simulated car drove of it.

    Attributes:
        route: Fingerprint of the route file.
        reverse: Against the order of its rows.
        car: Name of the car's set.
        world: Name under which it was computed.
        computed_s: Time of the computed flying lap.
        driven_s: Time of the flying lap that the predictive driver drove; None without one.
        standing_s: Time of its lap from rest, as an episode counts it.
        seed: Of the driver.
        version: Of the solver.
        offset_mm: To the left of the centre line, at each station.
        speed_mmps: Speeds there.
        clock_ms: Times since the first station.
        length_m: Length of the centre line.
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
        """Which lap it is."""
        return LimitKey(self.route, self.reverse, self.car)

    @property
    def validated(self) -> bool:
        """Whether the car drove near enough to the computed lap, and not faster."""
        if self.driven_s is None:
            return False
        return self.computed_s <= self.driven_s <= WITHIN * self.computed_s


def fingerprint(file: Path) -> str:
    """Of a route file: of its numbers if it is a .npy, else of its bytes; OSError, ValueError."""
    if file.suffix != ".npy":
        return hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    import numpy as np

    rows = np.load(file, allow_pickle=False).astype(np.float64).round(_DIGITS) + 0.0
    return hashlib.sha256(rows.tobytes()).hexdigest()[:16]


def write_limits(file: Path, limits: Iterable[StoredLimit]) -> None:
    """Write limits; a file of that name is replaced."""
    import numpy as np

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
    """The limits in a file; none where there is no readable one."""
    try:
        changed = file.stat().st_mtime_ns
    except OSError:
        return {}
    return _read(file, changed)


@lru_cache(maxsize=4)
def _read(file: Path, changed: int) -> Mapping[LimitKey, StoredLimit]:
    import zipfile

    import numpy as np

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
