#!/usr/bin/env bash
# deepracer-utils 1.5.6 (with pandas 3.1.1).
#
# What one expects: a log without a wall clock gives a table without one, or with NaN.
# What happens: a row of 18 fields, as simulator 5.3 writes them, ends with the counter of crashes with
# obstacles. It is taken for the wall clock, so all rows have the time 0.0, or the number of crashes.
# Rows of 19 fields, of simulator 6.0, end with the wall clock and are read as they are meant.
#
# Output seen:
#
#   18 fields, the last one the counter of crashes: wall_clock [0.0, 2.0]
#   19 fields, the last one the wall clock: wall_clock [1700000000.1, 1700000000.2]
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


def wall_clock(*ends: str) -> list[float]:
    """Of a log whose rows end with these fields."""
    with open("sim.log", "w") as file:
        for step, end in enumerate(ends, 1):
            row = f"0,{step},1.0,2.0,0.0,0.0,1.0,0,1.0,False,True,{step}.0,1,17.7,{step}.0"
            file.write(f"SIM_TRACE_LOG:{row},in_progress,0.0,{end}\n")
    rows = SimulationLogsIO.load_data("sim.log")
    return SimulationLogsIO.convert_to_pandas(rows)["wall_clock"].tolist()


old = wall_clock("0", "2")
print("18 fields, the last one the counter of crashes: wall_clock", old)
new = wall_clock("0,1700000000.1", "2,1700000000.2")
print("19 fields, the last one the wall clock: wall_clock", new)
sys.exit(0 if old == [0.0, 2.0] and new == [1700000000.1, 1700000000.2] else 1)
PYTHON
