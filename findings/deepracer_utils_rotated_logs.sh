#!/usr/bin/env bash
# deepracer-utils 1.5.6 (with pandas 3.1.1), and RotatingFileHandler of Python.
#
# What one expects: SimulationLogsIO.load_data, which joins sim.log with sim.log.1, sim.log.2 ..., gives
# the lines in the order in which they were written.
# What happens: it reads .1, .2, ... and then sim.log. Log rotation calls the newest old file .1, so
# the middle of the training comes before its beginning. Times between rows are then wrong too.
#
# Output seen:
#
#   files: sim.log, sim.log.1, sim.log.2
#   Loaded 3 log files (logs rolled over)
#   episodes in the order of load_data: 1 1 2 2 0 0 0 1 2
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "deepracer-utils==1.5.6" "pandas==3.1.1"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import logging.handlers
import os
import sys

os.environ["MPLBACKEND"] = "agg"
from deepracer.logs import SimulationLogsIO

handler = logging.handlers.RotatingFileHandler("sim.log", maxBytes=400, backupCount=5)
for episode in range(3):
    for step in range(1, 4):
        row = f"{episode},{step},1.0,2.0,0.0,0.0,1.0,0,1.0,False,True,{step}.0,1,17.7"
        line = f"SIM_TRACE_LOG:{row},{100 * episode + step}.0,in_progress,0.0"
        handler.emit(logging.makeLogRecord({"msg": line}))
handler.close()
print("files:", ", ".join(sorted(name for name in os.listdir() if name.startswith("sim.log"))))
episodes = [int(row.partition(",")[0]) for row in SimulationLogsIO.load_data("sim.log")]
print("episodes in the order of load_data:", *episodes)
sys.exit(0 if len(episodes) == 9 and episodes != sorted(episodes) else 1)
PYTHON
