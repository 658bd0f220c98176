"""Whether a training that ends at a lap time keeps its word: fresh laps of its best checkpoint.

    python scripts/bench goal [--lap-time 8.0] [--seeds 1 2 3 4 5] [--laps 100] [--minutes 15]
        [--files FOLDER] [--world NAME] [--teacher] [--json]

Each seed is a run of the real commands in an empty folder: `dr-start-training --until-lap-time`
with `defaults/rewards/speed`, and then `dr-evaluate --laps` from starts of another seed. With
--json the last line of stdout is one object with `seeds`, a list of

    seed         of the training
    train_s      wall time of the training command, seconds
    cpu_s        processor time of the command and its workers, seconds, without the bucket's server
    steps        learned from
    reached      whether the training ended at the lap time, and not at --minutes
    clean        of the fresh laps, those that were completed without a reset
    kept         of these, those that took at most the lap time
    median_s     of the clean laps, simulated seconds
    eval_share   share of the training's time that evaluations took, with all confirmations
"""

import argparse
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from lap import PROJECT, command_of, stop_storage
from machine import print_json

from drcli.model.history import decode_history

FRESH_SEED = 1_000
"""Added to the seed of a training for the starts of its fresh laps."""


def main() -> None:
    """Train with each seed, and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lap-time", type=float, default=8.0)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--laps", type=int, default=100)
    parser.add_argument("--minutes", type=float, default=15.0, help="longest training")
    parser.add_argument("--files", type=Path, default=PROJECT / "defaults" / "rewards" / "speed")
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--teacher", action="store_true", help="train with a teacher")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = []
    for seed in options.seeds:
        results.append(run_seed(seed, options))
        print(json.dumps(results[-1]), file=sys.stderr, flush=True)
    if options.json:
        print_json({"seeds": results})


def run_seed(seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Train once from nothing, and drive fresh laps."""
    with tempfile.TemporaryDirectory(prefix="bench-goal-") as place:
        folder = Path(place)
        for file in ("run.env", "system.env"):
            shutil.copy(PROJECT / file, folder / file)
        shutil.copytree(options.files, folder / "custom_files")
        environment = {**os.environ, "DR_WORLD_NAME": options.world}
        began_s = time.monotonic()
        limits = ["--until-lap-time", str(options.lap_time), "--max-minutes", str(options.minutes)]
        method = "--teacher" if options.teacher else "--no-teacher"
        train = ["start-training", "--foreground", "-q", method, "--seed", str(seed), *limits]
        before_s = cpu_seconds()
        subprocess.run(command_of(*train), cwd=folder, env=environment, check=True)
        train_s, cpu_s = time.monotonic() - began_s, cpu_seconds() - before_s
        drive = [
            "evaluate",
            "--json",
            "--laps",
            str(options.laps),
            "--seed",
            str(FRESH_SEED + seed),
        ]
        report = subprocess.run(
            command_of(*drive), cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
        )
        laps = json.loads(report.stdout.splitlines()[-1])["laps"]
        clean = [lap["lap_s"] for lap in laps if lap["progress"] >= 100 and not lap["resets"]]
        curve = next((folder / "data" / "s3").rglob("metrics/history.json"))
        log = next((folder / "data" / "logs").rglob("sim-0.log")).read_text("utf-8")
        share = re.search(r"Evaluations took .*?, ([\d.]+) % of the time", log)
        last = decode_history(curve.read_bytes())[-1]
        stop_storage(folder)
        return {
            "seed": seed,
            "train_s": round(train_s, 1),
            "cpu_s": round(cpu_s, 1),
            "steps": last.total_steps,
            "reached": train_s < 60.0 * options.minutes,
            "clean": len(clean),
            "kept": sum(lap_s <= options.lap_time for lap_s in clean),
            "median_s": median(clean) if clean else None,
            "eval_share": float(share[1]) / 100.0 if share else None,
        }


def cpu_seconds() -> float:
    """Processor time of all programs that this one has started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
