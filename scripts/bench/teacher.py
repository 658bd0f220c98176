"""What a teacher brings: time and laps of trainings with one, beside those without, in turn.

    python scripts/bench teacher [--worlds NAME ...] [--lap-times 8.0 6.5] [--seeds 1 2 3 4 5]
        [--minutes 5] [--files FOLDER] [--only-teacher] [--json]

Each training is one of `bench goal`: the real commands in an empty folder, until all evaluation
laps take at most the lap time, and then 40 fresh laps of the best checkpoint. The table has medians
over the seeds. With --json the last line of stdout is one object with `trainings`, a list of the
results of `bench goal`, each with `world`, `lap_time` and `teacher`.
"""

import argparse
import json
import sys
from pathlib import Path
from statistics import median
from typing import Any

from goal import run_seed
from lap import PROJECT
from machine import print_json

FRESH_LAPS = 40


def main() -> None:
    """Train with and without a teacher in turn, and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--worlds", nargs="+", default=["reinvent_base"])
    parser.add_argument("--lap-times", nargs="+", type=float, default=[8.0, 6.5])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--minutes", type=float, default=5.0, help="longest training")
    parser.add_argument("--files", type=Path, default=PROJECT / "defaults" / "rewards" / "speed")
    parser.add_argument("--only-teacher", action="store_true", help="leave the others out")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    methods = (True,) if options.only_teacher else (True, False)
    found: list[dict[str, Any]] = []
    for world in options.worlds:
        for lap_time in options.lap_times:
            for seed in options.seeds:
                for teacher in methods:
                    own = {"world": world, "lap_time": lap_time, "teacher": teacher}
                    each = argparse.Namespace(
                        **own, minutes=options.minutes, laps=FRESH_LAPS, files=options.files
                    )
                    found.append(own | run_seed(seed, each))
                    print(json.dumps(found[-1]), file=sys.stderr, flush=True)
            for teacher in methods:
                print(_line(world, lap_time, teacher, found), flush=True)
    if options.json:
        print_json({"trainings": found})


def _line(world: str, lap_time: float, teacher: bool, found: list[dict[str, Any]]) -> str:
    """The medians of one kind of training."""
    kind = {"world": world, "lap_time": lap_time, "teacher": teacher}
    own = [each for each in found if kind.items() <= each.items()]
    times = [median(each[name] for each in own) for name in ("train_s", "cpu_s", "kept")]
    laps = [each["median_s"] for each in own if each["median_s"] is not None]
    return (
        f"{world}, laps of {lap_time:g} s, {'a teacher' if teacher else 'no teacher'}: "
        f"{sum(each['reached'] for each in own)} of {len(own)} reached it, {times[0]:.0f} s, "
        f"{times[1]:.0f} processor seconds, {times[2]:.0f} of {FRESH_LAPS} fresh laps hold it"
        + (f", median lap {median(laps):.2f} s" if laps else "")
    )


if __name__ == "__main__":
    main()
