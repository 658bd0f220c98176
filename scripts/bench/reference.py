"""Repeats a recorded training of the reference and compares the learning curves.

    python scripts/bench reference --reference FOLDER [--picture FILE.png] [--json]

FOLDER is a DeepRacer-for-Cloud model folder of a time trial on `reinvent_base`: its
hyperparameters, action space and centre-line reward are trained with the real commands until as
many steps are learned from as the folder's traces hold. With --json the last line of stdout is one
object: `steps`, `wall_s`, `steps_per_s`, `reference_steps_per_s`, `mean_progress_last_5`,
`reference_progress_last_5`, `drive_s`, `learn_s`, `exchange_s`, `evaluation_laps` of the 3 that
`dr-evaluate` then drives with the best checkpoint, and `lap_s`, the fastest of them.
"""

import argparse
import csv
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from machine import print_json

from drcli.bucket.server import server
from drcli.config.loading import load_settings

PROJECT = Path(__file__).resolve().parents[2]

CENTRE_LINE_REWARD = """\
def reward_function(params):
    distance, width = params["distance_from_center"], params["track_width"]
    for share, reward in ((0.1, 1.0), (0.25, 0.5), (0.5, 0.1)):
        if distance <= share * width:
            return reward
    return 0.001
"""

TRAINING_S = 51.9 * 60.0
"""How long the recorded training took, seconds of simulated time with its pauses."""


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--reference", type=Path, required=True)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()

    reference = read_reference(arguments.reference)
    wanted = sum(steps for steps, _ in reference)
    history, laps_s = train(arguments.reference, wanted, arguments.seed)
    wall_s = sum(r["steps"] / r["steps_per_s"] for r in history)
    steps = history[-1]["total_steps"]
    result = {
        "steps": steps,
        "wall_s": wall_s,
        "steps_per_s": steps / wall_s,
        "reference_steps_per_s": wanted / TRAINING_S,
        "mean_progress_last_5": sum(r["mean_progress"] for r in history[-5:]) / 5,
        "reference_progress_last_5": sum(p for _, p in reference[-5:]) / 5,
        **{k: sum(r[k] for r in history) for k in ("drive_s", "learn_s", "exchange_s")},
        "evaluation_laps": len(laps_s),
        "lap_s": min(laps_s, default=None),
    }
    if arguments.picture:
        draw(reference, history, arguments.picture)
    if arguments.json:
        print_json(result)
    else:
        print(result)


def read_reference(folder: Path) -> list[tuple[int, float]]:
    """Steps and mean progress of each recorded iteration."""
    found = []
    for iteration in range(len(list((folder / "training-simtrace").glob("*-iteration.csv")))):
        path = folder / "training-simtrace" / f"{iteration}-iteration.csv"
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        ends = [float(row["progress"]) for row in rows if row["done"] == "True"]
        found.append((len(rows), sum(ends) / len(ends)))
    return found


def train(reference: Path, steps: int, seed: int) -> tuple[list[dict[str, Any]], list[float]]:
    """Train with the recorded inputs until that many steps are learned from, then evaluate.

    Returns:
        The learning curve, and the times of the completed evaluation laps, seconds.
    """
    with tempfile.TemporaryDirectory(prefix="bench-reference-") as name:
        folder = Path(name)
        for file in ("run.env", "system.env"):
            shutil.copy(PROJECT / file, folder / file)
        custom = folder / "custom_files"
        custom.mkdir()
        shutil.copy(reference / "ip" / "hyperparameters.json", custom)
        shutil.copy(reference / "model" / "model_metadata.json", custom)
        (custom / "reward_function.py").write_text(CENTRE_LINE_REWARD)
        with (folder / "run.env").open("a") as file:
            file.write("DR_TRAIN_EVAL_SHARE=1\n")
        dr(folder, "start-training", "-q", "--seed", str(seed))
        curve = folder / "data/s3/bucket/rl-deepracer-sagemaker/metrics/history.json"
        history: list[dict[str, Any]] = []
        while not history or history[-1]["total_steps"] < steps:
            time.sleep(0.5)
            try:
                history = json.loads(curve.read_text())["iterations"]
            except (OSError, ValueError):  # not there yet, or being replaced
                continue
        dr(folder, "stop-training")
        trials = json.loads(dr(folder, "evaluate", "--json", check=False).splitlines()[-1])[
            "trials"
        ]
        server.stop(load_settings(folder).storage)
        return history, [t["lap_s"] for t in trials if t["status"] == "Lap complete"]


def dr(folder: Path, *arguments: str, check: bool = True) -> str:
    """Run a command in a folder; what it printed."""
    program = Path(sys.executable).parent / "dr"
    done = subprocess.run(
        [str(program), *arguments], cwd=folder, check=check, stdout=subprocess.PIPE, text=True
    )
    return done.stdout


def draw(reference: list[tuple[int, float]], history: list[dict[str, Any]], path: Path) -> None:
    """Both learning curves over the steps."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    total, theirs = 0, []
    for steps, progress in reference:
        total += steps
        theirs.append((total, progress))
    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    axes.plot(*zip(*theirs, strict=True), marker="o", label="reference (DeepRacer-for-Cloud, 2022)")
    ours = [(r["total_steps"], r["mean_progress"]) for r in history]
    axes.plot(*zip(*ours, strict=True), marker="o", label="this project")
    axes.set(xlabel="steps", ylabel="mean progress of an iteration, %", ylim=(0, 101))
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
