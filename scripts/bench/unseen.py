"""How well one model laps tracks that it was never trained on.

    python scripts/bench unseen --tracks FOLDER [--worlds NAMES] [--minutes 5] [--laps 10]
        [--seed 1] [--speed 3.0] [--model NAME] [--set NAME=VALUE ...] [--keep FOLDER] [--table]
        [--json]

A training of the preset `unseen` by the real commands, in an empty folder with the route files of
FOLDER beside it; then so many laps of its best checkpoint on each track, from fresh starts, in
both directions. Without --worlds, the tracks are one of each circuit of FOLDER: names that differ
only in direction, width, league or scenery are variants; `all` is everything in FOLDER. --model
drives a ready-made model instead. --set changes a setting, such as DR_TRAIN_WORLDS; --speed is the
greatest one of the actions. --table prints all tracks as Markdown. With --json the last line of
stdout is one object with `train_s`, `cpu_s`, `checkpoint`, and `tracks`: name, direction, clean
laps, laps, and median lap time, seconds.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from goal import cpu_seconds
from lap import command_of, stop_storage
from machine import print_json

from drsim.track.worlds import load_track

VARIANTS = re.compile(r"_(c?cw|open|pro|f1|building|mini|mirrored|wide|track)$")
TRAINED = "reinvent_"
FRESH_SEED = 900


def main() -> None:
    """Train once, drive everywhere, and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tracks", type=Path, required=True, help="folder with route files")
    parser.add_argument("--worlds", default="", help="to be driven; default: one of each circuit")
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--laps", type=int, default=10, help="on each track, in each direction")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--speed", type=float, default=3.0)
    parser.add_argument("--model", help="a ready-made one, instead of a training")
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", dest="settings")
    parser.add_argument("--keep", type=Path, help="train here, and leave it")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-unseen-") as place:
        found = train_and_drive(options.keep or Path(place), options)
    clean = sum(each["clean"] for each in found["tracks"])
    laps = sum(each["laps"] for each in found["tracks"])
    for each in found["tracks"]:
        if each["clean"] < each["laps"]:
            way = "reversed" if each["reverse"] else "forward"
            print(f"{each['world']}, {way}: {each['clean']} of {each['laps']} laps clean")
    if options.table:
        print(table(found["tracks"]))
    print(
        f"{clean} of {laps} laps clean ({clean / laps:.1%}) after {found['train_s']:.0f} s, "
        f"{found['cpu_s']:.0f} processor seconds, {found['checkpoint']}"
    )
    if options.json:
        print_json(found)


def train_and_drive(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Figures of one training; see the module."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, **dict(each.split("=", 1) for each in options.settings)}

    def dr(*words: str) -> str:
        done = subprocess.run(
            command_of(*words),
            cwd=folder,
            env=environment,
            check=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
        )
        return done.stdout

    begins = ["--model", options.model] if options.model else ["--preset", "unseen"]
    dr("init", "--force", *begins)
    shutil.copytree(options.tracks, folder / "tracks", dirs_exist_ok=True)
    began_s, before_s = time.monotonic(), cpu_seconds()
    if not options.model:
        metadata = folder / "custom_files" / "model_metadata.json"
        value = json.loads(metadata.read_text())
        value["action_space"]["speed"]["high"] = options.speed
        metadata.write_text(json.dumps(value))
        limit = ["--max-minutes", str(options.minutes), "--seed", str(options.seed)]
        dr("start-training", "--foreground", "-q", *limit)
    train_s, cpu_s = time.monotonic() - began_s, cpu_seconds() - before_s
    rows = []
    worlds = options.worlds or ",".join(circuits(options.tracks))
    if worlds == "all":
        worlds = ",".join(sorted(path.stem for path in options.tracks.glob("*.npy")))
    for reverse in (False, True):
        words = ["--worlds", worlds, "--laps", str(options.laps), "--checkpoint", "best"]
        way = "--reverse" if reverse else "--no-reverse"
        report = json.loads(
            dr("evaluate", "--json", *words, way, "--seed", str(FRESH_SEED)).splitlines()[-1]
        )
        rows += [
            {
                "world": row["world"],
                "reverse": reverse,
                "clean": row["clean"],
                "laps": row["trials"],
                "median_s": row["median_s"],
            }
            for row in report["rows"]
        ]
        checkpoint = report["rows"][0]["checkpoint"]
    stop_storage(folder)
    return {
        "train_s": round(train_s, 1),
        "cpu_s": round(cpu_s, 1),
        "checkpoint": checkpoint,
        "tracks": rows,
    }


def table(rows: list[dict[str, Any]]) -> str:
    """A line for each track, both directions beside each other."""
    lines = ["| track | clean laps | median | reversed | median |", "| --- " * 5 + "|"]
    for forward in rows:
        if forward["reverse"]:
            continue
        back = next((r for r in rows if r["reverse"] and r["world"] == forward["world"]), None)
        cells = [forward["world"]]
        for each in (forward, back):
            median = each and each["median_s"]
            cells.append(f"{each['clean']} of {each['laps']}" if each else "not driven")
            cells.append("" if median is None else f"{median:.1f} s")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def circuits(tracks: Path) -> list[str]:
    """The first of all variants of each closed circuit, without the one that is trained."""
    found: dict[str, str] = {}
    for path in sorted(tracks.glob("*.npy")):
        name = path.stem
        while VARIANTS.search(name):
            name = VARIANTS.sub("", name)
        if not name.startswith(TRAINED) and load_track(path.stem, tracks).closed:
            found.setdefault(name, path.stem)
    return list(found.values())


if __name__ == "__main__":
    main()
