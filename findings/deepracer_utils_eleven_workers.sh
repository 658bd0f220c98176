#!/usr/bin/env bash
# deepracer-utils 1.5.6 (with pandas 3.1.1).
#
# What one expects: DeepRacerLog reads the folder of a training of DeepRacer-for-Cloud with any number
# of workers, whose traces are in 0/, 1/, ..., 10/.
# What happens: it takes one letter for the number of the worker, so that with more than ten workers
# it raises an error and reads nothing.
#
# Output seen:
#
#   a training with 10 workers: 10
#   a training with 11 workers: AttributeError: 'NoneType' object has no attribute 'groups'
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "deepracer-utils==1.5.6" "pandas==3.1.1"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import csv
import os
import sys

os.environ["MPLBACKEND"] = "agg"
from deepracer.logs import DeepRacerLog

COLUMNS = (
    "episode,steps,X,Y,yaw,steer,throttle,action,reward,done,all_wheels_on_track,progress,"
    "closest_waypoint,track_len,tstamp,episode_status,pause_duration,obstacle_crash_counter"
)


def write(folder: str, iteration: int) -> None:
    """A trace of two episodes of three steps."""
    os.makedirs(f"{folder}/training-simtrace", exist_ok=True)
    with open(f"{folder}/training-simtrace/{iteration}-iteration.csv", "w") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS.split(","))
        for episode in (2 * iteration, 2 * iteration + 1):
            for step in (1, 2, 3):
                row = [episode, step, 1.0, 2.0, 0.0, 0.0, 1.0, 0, 1.0, False, True, float(step), 1]
                rows.writerow([*row, 17.7, 10 * episode + step, "in_progress", 0.0, 0])


def loaded(folder: str):
    """The rows of a model folder."""
    log = DeepRacerLog(folder, verbose=False)
    log.load_training_trace(ignore_metadata=True)
    return log.dataframe()


results = {}
for workers in (10, 11):
    for worker in range(workers):
        for iteration in (0, 1):
            write(f"of-{workers}/{worker}", iteration)
    try:
        results[workers] = str(loaded(f"of-{workers}")["worker"].nunique())
    except Exception as error:
        results[workers] = f"{type(error).__name__}: {error}"
    print(f"a training with {workers} workers: {results[workers]}")
sys.exit(0 if results[10] == "10" and results[11].startswith("AttributeError") else 1)
PYTHON
