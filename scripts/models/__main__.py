"""Trains the ready-made models of defaults/models, measures how they drive, and writes their cards.

python scripts/models NAME ... [--folder FOLDER]
python scripts/models NAME --finished FOLDER

Each model has a recipe, defaults/models/NAME/training.json: seed, number of updates, settings. A
training with the same recipe gives the same weights on the same kind of processor, with the same
number of cores and the same versions; `card.json` names all of them. Trainings run with low
priority, one after the other. `--folder` keeps the working folders there. `--finished` takes a
training that has ended in such a folder.

The best checkpoint, or the last one if the recipe says so, is rounded to half precision. Then it is
driven as by `dr-evaluate`: three laps in each direction on the tracks of the recipe, without
disturbances, and on the first one with those of the training. So the card describes exactly what
racers get.
"""

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import psutil
from drive_laps import drive_laps

from drcli.base.json_record import json_default
from drcli.config.presets import READY_MADE
from drcli.convert.half_weights import halved
from drcli.model.run_metadata import processor_name
from drcli.records.checkpoint import CheckpointRecord
from drcli.records.iteration import decode_history
from drcli.records.scores import Scores
from drcli.transfer.ready_made import (
    CARD_FILE,
    MODEL_FILES,
    TRAINING_FILE,
    WEIGHTS_FILE,
    Card,
    DrivenLaps,
    Recipe,
    read_ready_made,
    read_recipe,
)

PROJECT = Path(__file__).resolve().parents[2]
MODELS = PROJECT / "defaults" / "models"

REPEATABLE = {
    # Which checkpoint is best must not depend on the clock: each is evaluated.
    "DR_TRAIN_EVAL_SHARE": "1",
    # The number of cores decides how sums are rounded.
    "DR_THREADS": "2",
    "DR_TRAIN_OVERLAP": "off",
    "DR_PRIORITY": "low",
}

_CPU_FILE = "processor_seconds.json"

_POLL_S = 2.0


def main() -> None:
    """Train, measure and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="+", choices=READY_MADE, metavar="NAME")
    parser.add_argument("--folder", type=Path, help="keep the working folders there")
    parser.add_argument("--finished", type=Path, help="take the training in this working folder")
    options = parser.parse_args()
    if options.finished and len(options.names) > 1:
        parser.error("--finished takes one NAME")
    for name in options.names:
        with tempfile.TemporaryDirectory(prefix="ready-made-") as temporary:
            kept = (options.folder or Path(temporary)).absolute()
            recipe = read_recipe(name)
            folder = (options.finished or kept / name).absolute()
            if not options.finished:
                train(name, recipe, folder)
            card = take_model(name, recipe, folder)
            write_card(name, card)  # to read the model as everybody does
            laps = measure(name, recipe)
            write_card(name, replace(card, laps=laps))
            for measured in laps:
                print(f"{name}: {measured}")


def train(name: str, recipe: Recipe, folder: Path) -> None:
    """Train in a new working folder, with the commands of a racer, until the training has ended.

    Raises:
        RuntimeError: It ended otherwise, or an iteration lacks the episodes of a worker.
    """
    dr("init", str(folder), "--force", "--prefix", name, cwd=PROJECT)
    custom = folder / "custom_files"
    for file in MODEL_FILES:
        (custom / file).write_bytes((MODELS / name / file).read_bytes())
    parameters = json.loads((custom / "hyperparameters.json").read_text())
    (custom / "hyperparameters.json").write_text(json.dumps(parameters | recipe.hyperparameters))
    for number, own in enumerate(recipe.worker_settings, start=2):
        lines = "".join(f"{key}={value}\n" for key, value in own.items())
        (folder / f"worker-{number}.env").write_text(lines)
    settings = {
        **REPEATABLE,
        **recipe.settings,
        "DR_TRAIN_SEED": str(recipe.seed),
        "DR_TRAIN_MAX_ITERATIONS": str(recipe.iterations),
    }
    if recipe.starts_from:
        start = recipe.starts_from
        dr("init", "--experiment", start, "--model", start, "--force", cwd=folder)
        settings |= {
            "DR_LOCAL_S3_PRETRAINED": "True",
            "DR_LOCAL_S3_PRETRAINED_PREFIX": start,
            "DR_LOCAL_S3_PRETRAINED_CHECKPOINT": "last",
        }
    try:
        dr("start-training", "-q", cwd=folder, settings=settings)
        watch(folder)
    finally:
        dr("stop-all", cwd=folder)


def watch(folder: Path) -> None:
    """Wait for the end of a training, and note the processor time of its workers.

    Raises:
        RuntimeError: It failed.
    """
    spent: dict[str, float] = {}
    while True:
        record = json.loads((folder / "data" / "runs" / "0" / "run.json").read_text())
        for worker in record["workers"]:
            try:
                times = psutil.Process(worker["pid"]).cpu_times()
            except (psutil.Error, TypeError):  # it has ended, or does not run yet
                continue
            spent[str(worker["pid"])] = times.user + times.system
        (folder / _CPU_FILE).write_text(json.dumps(spent))
        if record["state"] not in ("starting", "running"):
            break
        time.sleep(_POLL_S)
    if record["state"] != "finished":
        raise RuntimeError(f"The training ended as {record['state']}: {record['message']}")


def take_model(name: str, recipe: Recipe, folder: Path) -> Card:
    """Copy the chosen checkpoint of a finished training, in half precision; its card without laps.

    Raises:
        RuntimeError: The training has not made it, or cannot be repeated.
    """
    bucket = folder / "data" / "s3" / "bucket" / name
    history = decode_history((bucket / "metrics" / "history.json").read_bytes())
    episodes = {record.episodes for record in history}
    if len(episodes) > 1 and "training_method" not in recipe.hyperparameters:
        raise RuntimeError(
            f"Some iterations have fewer episodes: {sorted(episodes)}. A worker came too late, so "
            "this training cannot be repeated. Train again on a less busy machine."
        )
    if recipe.checkpoint == "best":
        scores = Scores.decode((bucket / "model" / "deepracer_checkpoints.json").read_bytes())
        checkpoint = scores.best_checkpoint.name
    else:
        starts = [path.name for path in (bucket / "model").glob(f"{recipe.iterations}_Step-*.json")]
        if not starts:
            raise RuntimeError(f"{folder} has no checkpoint {recipe.iterations}.")
        checkpoint = starts[0].removesuffix(".json")
    record = CheckpointRecord.decode((bucket / "model" / f"{checkpoint}.json").read_bytes())
    tensors = (bucket / "model" / f"{checkpoint}.safetensors").read_bytes()
    (MODELS / name / WEIGHTS_FILE).write_bytes(halved(tensors))
    spent = json.loads((folder / _CPU_FILE).read_text())
    return Card(
        checkpoint=checkpoint,
        episodes=record.counters.episodes,
        sha256=hashes(name),
        commit=commit(),
        versions={
            "drcli": version("drcli"),
            "python": platform.python_version(),
            "torch": version("torch"),
        },
        processor=f"{processor_name()}, 2 cores",
        number_format=record.counters.number_format or "",
        processor_minutes=round(sum(spent.values()) / 60, 1),
        laps=[],
    )


def measure(name: str, recipe: Recipe) -> list[DrivenLaps]:
    """Drive the shipped model as `dr-evaluate` does in a folder of `dr-init --model`."""
    model = read_ready_made(name)
    laps = [
        drive_laps(model, world, reverse=reverse, disturbed=False)
        for world in recipe.drives
        for reverse in (False, True)
    ]
    if any(key.startswith("DR_SIM_") for key in recipe.settings):
        laps.append(drive_laps(model, recipe.drives[0], reverse=False, disturbed=True))
    return laps


def write_card(name: str, card: Card) -> None:
    """Write card.json."""
    text = json.dumps(card.to_json(), indent=1, default=json_default)
    (MODELS / name / CARD_FILE).write_text(text + "\n")


def hashes(name: str) -> dict[str, str]:
    """SHA-256 of the files of a model that the card describes."""
    files = (*MODEL_FILES, TRAINING_FILE, WEIGHTS_FILE)
    return {file: hashlib.sha256((MODELS / name / file).read_bytes()).hexdigest() for file in files}


def commit() -> str:
    """The commit of this checkout."""
    done = subprocess.run(
        ["git", "rev-parse", "--short=12", "HEAD"],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def dr(*words: str, cwd: Path, settings: Mapping[str, str] | None = None) -> str:
    """Run one of our commands; returns its output.

    Raises:
        CalledProcessError: It failed.
    """
    outside = {key: value for key, value in os.environ.items() if not key.startswith("DR_")}
    environment: dict[str, Any] = {**outside, **(settings or {})}
    program = Path(sys.executable).parent / "dr"
    done = subprocess.run(
        [str(program), *words],
        cwd=cwd,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout


if __name__ == "__main__":
    main()
