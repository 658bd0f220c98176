#!/usr/bin/env bash
# deepracer-utils 1.5.6 (with pandas 3.1.1).
#
# What one expects: SimulationLogsIO.normalize_rewards scales the rewards of the rows that it gets to
# 0 to 1.
# What happens: it numbers the results from 0 and assigns them by row number. Rows that were chosen
# from a longer table, such as the last iterations, get NaN or the result of another row.
#
# Output seen:
#
#   rewards of episode 1: 11 12 13; normalized: nan nan nan
#   rewards of episodes 0 and 2: 1 2 3 21 22 23; normalized: 0.00 0.05 0.09 nan nan nan
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "deepracer-utils==1.5.6" "pandas==3.1.1"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import os
import sys

os.environ["MPLBACKEND"] = "agg"
from deepracer.logs import SimulationLogsIO

rows = [
    f"{episode},{step},1.0,2.0,0.0,0.0,1.0,0,{10 * episode + step},False,True,{step}.0,1,17.7,"
    f"{100 * episode + step}.0,in_progress,0.0"
    for episode in range(3)
    for step in range(1, 4)
]
table = SimulationLogsIO.convert_to_pandas(rows, 1)
unknown = []
for title, chosen in (
    ("episode 1", table[table["episode"] == 1].copy()),
    ("episodes 0 and 2", table[table["episode"] != 1].copy()),
):
    before = " ".join(f"{reward:.0f}" for reward in chosen["reward"])
    SimulationLogsIO.normalize_rewards(chosen)
    after = " ".join(f"{reward:.2f}" for reward in chosen["reward"])
    print(f"rewards of {title}: {before}; normalized: {after}")
    unknown.append(int(chosen["reward"].isna().sum()))
sys.exit(0 if unknown == [3, 3] else 1)
PYTHON
