#!/usr/bin/env bash
# deepracer-utils 1.5.6 (with pandas 3.1.1).
#
# What one expects: a worker that has no trace of iteration 0, because it joined later or the oldest
# traces were deleted, lacks these rows, and nothing else.
# What happens: the number of episodes in an iteration is counted in iteration 0 of each worker. If one
# worker has none, unique_episode of all rows of all workers is NaN, without a warning, and what is
# grouped by it is empty.
#
# Output seen:
#
#   rows: 30; without a number in unique_episode: 30
#   of worker 0, which was there from the start: 18
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


for iteration in (0, 1, 2):
    write("model/0", iteration)
for iteration in (1, 2):  # of a worker that joined later
    write("model/1", iteration)
rows = loaded("model")
unknown = int(rows["unique_episode"].isna().sum())
print(f"rows: {len(rows)}; without a number in unique_episode: {unknown}")
first = rows[rows["worker"] == 0]
print(f"of worker 0, which was there from the start: {int(first['unique_episode'].isna().sum())}")
sys.exit(0 if unknown == len(rows) == 30 else 1)
PYTHON
