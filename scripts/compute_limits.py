"""Recompute the fastest laps that come with the program: drcli/tracks/limits.npz.

Needs the extra `limit`. Goes on where it was interrupted: laps that the file has are kept. Run it
from the root of the project:

    python scripts/compute_limits.py --tracks ../shared/tracks --cars release-6,low-grip,2022
"""

import argparse
import multiprocessing
import time
from collections.abc import Iterator
from pathlib import Path

from drcli.base.errors import DrError
from drcli.drive.racer_limit import compute_limit
from drcli.tracks.limit_store import (
    SHIPPED,
    SOLVER_VERSION,
    LimitKey,
    StoredLimit,
    fingerprint,
    read_limits,
    write_limits,
)
from drsim.car.car_parameters import CAR_SETS

DEFINITIONS = Path("env/drsim/track/definitions")
EVERY = 10
"""Laps after which the file is written."""

Task = tuple[Path, LimitKey, tuple[int, ...]]


def main() -> None:
    """Compute what the file does not have."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", type=Path, default=Path("tracks"), help="folder of routes")
    parser.add_argument("--cars", default=",".join(CAR_SETS))
    parser.add_argument("--only", default="", help="names of tracks, with commas")
    parser.add_argument("--directions", default="forward,reverse")
    parser.add_argument("--seeds", default="1", help="of the drives; empty to only compute")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--file", type=Path, default=SHIPPED)
    parser.add_argument("--again", action="store_true", help="drive again what is not validated")
    given = parser.parse_args()
    known = dict(read_limits(given.file))
    seeds = tuple(int(seed) for seed in given.seeds.split(",") if seed)
    files = [*sorted(DEFINITIONS.glob("*.json")), *sorted(given.tracks.glob("*.npy"))]
    named = given.only.split(",") if given.only else [file.stem for file in files]
    files = [file for name in named for file in files if file.stem == name]
    tasks: dict[LimitKey, Task] = {}
    for car in given.cars.split(","):
        for direction in given.directions.split(","):
            for file in files:
                key = LimitKey(fingerprint(file), direction == "reverse", car)
                found = known.get(key)
                if not _settled(found, bool(seeds), again=given.again):
                    tasks.setdefault(key, (file, key, seeds))
    began = time.monotonic()
    for done, limit in enumerate(_computed(list(tasks.values()), given.processes), start=1):
        known[limit.key] = _better(known.get(limit.key), limit)
        drove = "not driven" if limit.driven_s is None else f"driven {limit.driven_s:.2f} s"
        way = "reverse" if limit.reverse else "forward"
        print(
            f"{done}/{len(tasks)} {time.monotonic() - began:.0f} s: {limit.world} {way} "
            f"{limit.car} {limit.computed_s:.2f} s, {drove}",
            flush=True,
        )
        if done % EVERY == 0 or done == len(tasks):
            write_limits(given.file, {**read_limits(given.file), **known}.values())


def _settled(found: StoredLimit | None, drives: bool, *, again: bool) -> bool:
    """Whether a lap need not be computed."""
    if found is None or found.version != SOLVER_VERSION:
        return False
    return not drives or found.validated or (found.driven_s is not None and not again)


def _better(old: StoredLimit | None, new: StoredLimit) -> StoredLimit:
    """The one that was driven faster, of laps of one version."""
    if old is None or old.version != new.version or old.driven_s is None:
        return new
    return old if new.driven_s is None or old.driven_s <= new.driven_s else new


def _computed(tasks: list[Task], processes: int) -> Iterator[StoredLimit]:
    if processes == 1:
        yield from (limit for task in tasks if (limit := _one(task)))
        return
    with multiprocessing.Pool(processes) as pool:
        yield from (limit for limit in pool.imap_unordered(_one, tasks) if limit)


def _one(task: Task) -> StoredLimit | None:
    file, key, seeds = task
    try:
        return compute_limit(file, key.route, reverse=key.reverse, car=key.car, seeds=seeds)
    except DrError as error:
        print(f"{error} {error.remedy}", flush=True)
        return None


if __name__ == "__main__":
    main()
