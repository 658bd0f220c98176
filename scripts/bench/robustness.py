"""Whether the score of `dr-evaluate --robust` orders models as disturbances outside its grid do.

Each model of a working folder drives the grid, which gives its robust_score, and then laps under
held-out disturbances: levels and combinations that are not in the grid. The two rankings should
agree (Spearman's rank correlation of 0.8 or more). `--train` makes the models first: two trainings,
with and without randomisation, whose checkpoints of different ages are kept as models.
"""

import argparse
import json
import os
import secrets
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from drcli.bucket.connect import open_bucket
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.drive.evaluate_many import Cell, drive_cells, grid
from drcli.drive.evaluator import Entry
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.evaluation_task import robust_score
from drcli.records.job import Job
from drcli.run.evaluation_plan import choose_checkpoint
from drcli.run.many_evaluations import matching_models
from drcli.workers.cores import cores
from drcli.workers.worker_process import StopSignal
from drsim.car.conditions import Conditions
from drsim.track.worlds import load_track

BAR = 0.8
"""Least rank correlation."""

HELD_OUT, LAPS = 12, 2
"""Held-out disturbances, each from every start of the grid, and laps of an episode under them."""

STAGES = {"plain": (5, 10, 16, 22, 24), "random": (8, 16, 26, 34, 36)}
"""Iterations after which the two trainings are kept as models."""

RANDOMISED = """
DR_ENABLE_DOMAIN_RANDOMIZATION=True
DR_RANDOMIZE_TEXTURES=True
DR_SIM_EXTRAS_IN=training
DR_SIM_IMAGE_NOISE=8
DR_SIM_BRIGHTNESS=0.4
DR_SIM_LATENCY_JITTER=0.08
DR_SIM_FRICTION=0.2
DR_SIM_CAMERA_ANGLE=2
DR_TRAIN_ALTERNATE_DRIVING_DIRECTION=True
"""
"""Settings of the training with randomisation."""


@dataclass(frozen=True)
class Ranked:
    """A model, its score on the grid, and its laps under what is not in the grid.

    Attributes:
        robust_score: 0 to 100.
        mean_laps: Laps before the first violation under held-out disturbances, of `LAPS`.
    """

    model: str
    checkpoint: str
    robust_score: float
    mean_laps: float


def held_out(seed: int) -> list[Cell]:
    """Disturbances whose levels and combinations are not in the grid: two or three at a time."""
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, 77])))
    draws = {
        "brightness": lambda: random.uniform(0.45, 1.7),
        "image_noise": lambda: random.uniform(4.0, 40.0),
        "blur_px": lambda: random.uniform(0.3, 1.5),
        "glare": lambda: random.uniform(0.2, 0.9),
        "reflections": lambda: random.uniform(0.2, 0.9),
        "latency_s": lambda: random.uniform(0.01, 0.12),
        "friction": lambda: random.uniform(0.5, 1.3),
        "mass": lambda: random.uniform(0.7, 1.3),
        "battery": lambda: random.uniform(0.75, 1.15),
        "steering_trim_deg": lambda: random.uniform(-6.0, 6.0),
        "steering_left": lambda: random.uniform(0.6, 1.0),
        "steering_right": lambda: random.uniform(0.6, 1.0),
    }
    cells = []
    for number in range(HELD_OUT):
        names = random.choice(sorted(draws), size=2 + number % 2, replace=False).tolist()
        values = {name: float(draws[name]()) for name in names}
        side = ("centre", "left", "right")[number % 3]
        other_way = number % 6 == 5
        label = ", ".join(f"{name} {value:.3g}" for name, value in values.items())
        cells.append(Cell("held out", label, Conditions(**values), side, other_way=other_way))
    return cells


def rank_correlation(first: Sequence[float], second: Sequence[float]) -> float:
    """Spearman's: the correlation of the ranks, equal values with the mean of their ranks."""
    ranks = [_ranks(values) for values in (first, second)]
    return float(np.corrcoef(*ranks)[0, 1])


def _ranks(values: Sequence[float]) -> list[float]:
    return [
        sum(other < value for other in values) + (sum(other == value for other in values) + 1) / 2
        for value in values
    ]


def ranked(settings: Settings, prefix: str, checkpoint: str, seed: int) -> Ranked:
    """Drive the grid and the held-out disturbances with one model."""
    run = settings.run
    with tempfile.TemporaryDirectory() as folder:
        job = Job(run, secrets.token_hex(6), seed, None, Path(folder), os.getppid())
        config = replace(run, model=replace(run.model, prefix=prefix))
        stamp = "20000101000000"
        entry = Entry(
            prefix,
            checkpoint,
            keys.evaluation_trace(prefix, stamp),
            keys.evaluation_metrics(prefix, stamp),
        )
        bucket, stop_signal = open_bucket(run.storage), StopSignal(os.getppid())
        closed = load_track(run.race().world_name, run.race().tracks_folder).closed
        found = [
            drive_cells(job, stop_signal, bucket, entry, config, cells, threads=cores(), laps=laps)
            for cells, laps in ((grid(seed, closed=closed), 1), (held_out(seed), LAPS))
        ]
    laps = sum(cell.progress for cell in found[1]) / len(found[1]) / 100.0 * LAPS
    return Ranked(prefix, checkpoint, robust_score(found[0]), round(laps, 3))


def train(folder: Path) -> None:
    """Train the models into the bucket of a working folder that does not exist yet."""
    programs = Path(sys.executable).parent
    for name, stages in STAGES.items():
        home = folder if name == "plain" else folder / name
        subprocess.run([programs / "dr-init", home, "--yes", "-q", "--prefix", name], check=True)
        run_env = home / "run.env"
        if name == "random":
            run_env.write_text(run_env.read_text() + RANDOMISED)
        for stage in stages:
            how = "--resume" if stage != stages[0] else "-w"
            subprocess.run(
                [programs / "dr-start-training", how, "--foreground", "--seed", "7"],
                cwd=home,
                env={
                    **os.environ,
                    "DR_TRAIN_MAX_ITERATIONS": str(stage),
                    "DR_TRAIN_EVAL_SHARE": "0.02",
                },
                stdin=subprocess.DEVNULL,
                check=True,
            )
            copy = folder / "data" / "s3" / "bucket" / f"{name}-{stage}"
            shutil.copytree(home / "data" / "s3" / "bucket" / name, copy)


def main() -> None:
    """Rank the models and print the two rankings and their correlation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="working folder with the models")
    parser.add_argument("--models", default="plain-*,random-*", help="prefixes with * and ?")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--checkpoint", choices=("best", "last"), default="best")
    parser.add_argument("--train", action="store_true", help="make folder and models first")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    options = parser.parse_args()
    if options.train:
        train(options.folder)
    settings = load_settings(options.folder).replaced(eval_checkpoint=options.checkpoint)
    bucket = open_bucket(settings.storage)
    rows = []
    for prefix in matching_models(bucket, options.models.split(",")):
        began_s, before = time.monotonic(), time.process_time()
        row = ranked(
            settings, prefix, choose_checkpoint(settings, ModelStore(bucket, prefix)), options.seed
        )
        rows.append(row)
        print(
            f"{row.model:20} {row.checkpoint:24} robust_score {row.robust_score:6.2f}   laps "
            f"{row.mean_laps:5.3f} of {LAPS}   {time.process_time() - before:5.1f} s of processor "
            f"time, {time.monotonic() - began_s:5.1f} s",
            flush=True,
        )
    found = rank_correlation([row.robust_score for row in rows], [row.mean_laps for row in rows])
    print(f"Rank correlation {found:.3f} over {len(rows)} models; bar {BAR}.")
    if options.json:
        report = {"rank_correlation": found, "bar": BAR, "models": list(map(asdict, rows))}
        options.json.write_text(json.dumps(report, indent=2) + "\n")
    sys.exit(0 if found >= BAR else 1)


if __name__ == "__main__":
    main()
