"""Memory of a training with the longest iterations, 10,000 steps.

    python scripts/bench memory [--json]

Trains one iteration of 100 slow episodes with the real commands and adds up, twice a second, the
proportional set size (PSS: shared pages counted once) of every process of the run: supervisor,
trainer, simulation worker and embedded server. With --json the last line of stdout is one object:
`steps`, `peak_mb`, `peaks_mb` by process, `frames_mb` (the raw frames of the iteration),
`trainer_bound_mb` (half as much again and 300 MB) and `trainer_ratio_to_bound`.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
from machine import print_json

from drcli.bucket.server import server
from drcli.config.loading import load_settings
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH

PROJECT = Path(__file__).resolve().parents[2]
SPEED_MPS = 0.3
"""So slow that 100 episodes of an untrained policy last 10,000 steps."""

FRAMES_FACTOR, OTHER_MB = 1.5, 300.0
"""Largest memory of the trainer: so many times the raw frames, plus so much."""


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-memory-") as name:
        result = measure(Path(name))
    if arguments.json:
        print_json(result)
    else:
        print(result)


def measure(folder: Path) -> dict[str, Any]:
    """Train one iteration in an empty folder and watch its processes."""
    for file in ("run.env", "system.env"):
        shutil.copy(PROJECT / file, folder / file)
    custom = folder / "custom_files"
    shutil.copytree(PROJECT / "defaults", custom)
    parameters = json.loads((custom / "hyperparameters.json").read_text())
    parameters |= {"num_episodes_between_training": 100, "term_cond_max_episodes": 1}
    (custom / "hyperparameters.json").write_text(json.dumps(parameters))
    metadata = json.loads((custom / "model_metadata.json").read_text())
    metadata["action_space"] = [
        {"steering_angle": angle, "speed": SPEED_MPS} for angle in (-30, -15, 0, 15, 30)
    ]
    (custom / "model_metadata.json").write_text(json.dumps(metadata))

    program = Path(sys.executable).parent / "dr"
    subprocess.run([str(program), "start-training", "-q"], cwd=folder, check=True)
    run_file = folder / "data" / "runs" / "0" / "run.json"
    server_pid = json.loads((folder / "data" / "s3" / ".server.json").read_text())["pid"]
    peak_mb, peaks_mb = 0.0, dict[str, float]()
    while (record := json.loads(run_file.read_text()))["state"] in ("starting", "running"):
        pids = {worker["name"]: worker["pid"] for worker in record["workers"]}
        pids |= {"supervisor": record["pid"], "server": server_pid}
        now_mb = {name: pss_mb(pid) for name, pid in pids.items() if pid}
        peak_mb = max(peak_mb, sum(now_mb.values()))
        peaks_mb |= {n: max(mb, peaks_mb.get(n, 0.0)) for n, mb in now_mb.items()}
        time.sleep(0.5)
    curve = folder / "data/s3/bucket/rl-deepracer-sagemaker/metrics/history.json"
    steps = json.loads(curve.read_text())["iterations"][0]["steps"]
    server.stop(load_settings(folder).storage)
    frames_mb = steps * FRAME_HEIGHT * FRAME_WIDTH / 1e6
    bound_mb = FRAMES_FACTOR * frames_mb + OTHER_MB
    return {
        "steps": steps,
        "peak_mb": peak_mb,
        "peaks_mb": peaks_mb,
        "frames_mb": frames_mb,
        "trainer_bound_mb": bound_mb,
        "trainer_ratio_to_bound": peaks_mb["trainer"] / bound_mb,
    }


def pss_mb(pid: int) -> float:
    """Memory of a process in MB, 0 once it has ended."""
    try:
        return float(psutil.Process(pid).memory_full_info().pss) / 1e6
    except psutil.NoSuchProcess:
        return 0.0


if __name__ == "__main__":
    main()
