"""Measures how long dr-analyze takes, and how much memory: by default, two million steps.

It makes a training whose cars drive further from iteration to iteration, with traces of all columns
and metrics, and analyses it in a process of its own. With --folder, it analyses that model instead.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from drcli.records.trace import CSV_HEADER
from drsim.track.track import Track
from drsim.track.worlds import load_track

ANGLES, SPEEDS = (-30.0, -15.0, 0.0, 15.0, 30.0), (0.5, 1.0)
EPISODES = 20
STEP_S = 1.0 / 15.0


def write_training(folder: Path, iterations: int, steps: int, seed: int = 0) -> None:
    """Write a training of about so many steps, with discrete actions, on reinvent_base."""
    track = load_track("reinvent_base")
    random = np.random.default_rng(seed)
    actions = [{"steering_angle": a, "speed": s} for a in ANGLES for s in SPEEDS]
    (folder / "model").mkdir(parents=True)
    (folder / "ip").mkdir()
    (folder / "training-simtrace").mkdir()
    metadata = {"action_space": actions, "sensor": ["FRONT_FACING_CAMERA"], "version": "5"}
    (folder / "model" / "model_metadata.json").write_text(json.dumps(metadata))
    parameters = {"num_episodes_between_training": EPISODES, "discount_factor": 0.99}
    (folder / "ip" / "hyperparameters.json").write_text(json.dumps(parameters))
    mean_steps = steps / iterations / EPISODES
    for iteration in range(iterations):
        share = 0.5 + iteration / max(1, iterations - 1)
        lengths = np.maximum(2, random.gamma(4.0, share * mean_steps / 4.0, EPISODES).astype(int))
        frames = [
            _episode(track, random, EPISODES * iteration + k, int(length))
            for k, length in enumerate(lengths)
        ]
        path = folder / "training-simtrace" / f"{iteration}-iteration.csv"
        pd.concat(frames).to_csv(path, index=False, lineterminator="\n")


def _episode(track: Track, random: np.random.Generator, number: int, length: int) -> pd.DataFrame:
    """A drive along the centre line that ends off the track, or with a lap."""
    action = random.integers(len(ANGLES) * len(SPEEDS), size=length)
    speed = np.array(SPEEDS)[action % len(SPEEDS)]
    start = random.integers(len(track.center) - 1)
    segments_m = np.hypot(*np.diff(track.center, axis=0).T)
    along_m = np.concatenate([[0.0], np.cumsum(segments_m)])
    driven_m = np.cumsum(speed * STEP_S) - speed[0] * STEP_S
    length_m = along_m[-1]
    lap = np.flatnonzero(driven_m >= length_m)
    end = int(lap[0]) + 1 if len(lap) else length
    driven_m = np.minimum(driven_m[:end], length_m)
    place_m = (along_m[start] + driven_m) % length_m
    x, y = (np.interp(place_m, along_m, track.center[:, axis]) for axis in (0, 1))
    offset = 0.3 * np.sin(place_m) + random.normal(0.0, 0.02, end)
    status = np.full(end, "in_progress", object)
    status[0], status[-1] = "prepare", "lap_complete" if len(lap) else "off_track"
    clock_s = 1000.0 * number + STEP_S * np.arange(end)
    reward = np.where(np.arange(end) > 0, speed[:end] * (1.0 - np.abs(offset)), 0.0)
    columns = (
        np.full(end, number),
        np.arange(1.0, end + 1.0),
        x + offset,
        y + offset,
        random.uniform(-180.0, 180.0, end),
        np.array(ANGLES)[action[:end] // len(SPEEDS)],
        speed[:end],
        action[:end],
        reward,
        np.arange(end) == end - 1,
        np.abs(offset) < 0.35,
        100.0 * driven_m / length_m,
        np.minimum(np.searchsorted(along_m, place_m), len(track.center) - 1),
        np.full(end, length_m),
        clock_s,
        status,
        np.zeros(end),
        np.zeros(end, int),
        1.7e9 + clock_s / 30.0,
        np.where(np.arange(end) > 0, 0.002, 0.0),
    )
    return pd.DataFrame(dict(zip(CSV_HEADER.split(","), columns, strict=True)))


def measure(folder: Path, options: list[str]) -> None:
    """Analyse a model in a process of its own and print what that took."""
    began = time.monotonic()
    command = [str(Path(sys.executable).with_name("dr-analyze")), str(folder), "--json", *options]
    with tempfile.TemporaryDirectory() as here:
        (Path(here) / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")
        ended = subprocess.run(
            command, capture_output=True, text=True, cwd=here, env={**os.environ, "DR_DIR": here}
        )
    wall_s = time.monotonic() - began
    if ended.returncode:
        sys.exit(ended.stderr)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads(ended.stdout.splitlines()[-1])
    print(f"iterations       {len(report['iterations'])}")
    print(f"steps            {report['steps']:,}")
    print(f"wall time        {wall_s:.1f} s")
    print(f"processor time   {used.ru_utime + used.ru_stime:.1f} s")
    print(f"greatest memory  {used.ru_maxrss / 1e6:.2f} GB")


def main() -> None:
    """Make a training, or take one, and analyse it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="Analyse this model.")
    parser.add_argument("--iterations", type=int, default=500)
    parser.add_argument("--steps", type=int, default=2_000_000)
    parser.add_argument("--html", type=Path, help="Write the report too.")
    given = parser.parse_args()
    options = ["--html", str(given.html.resolve())] if given.html else []
    if given.folder is not None:
        measure(given.folder.resolve(), options)
        return
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "long-run"
        write_training(folder, given.iterations, given.steps)
        measure(folder, options)


if __name__ == "__main__":
    main()
