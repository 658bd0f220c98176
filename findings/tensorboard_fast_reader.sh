#!/usr/bin/env bash
# TensorBoard 2.21.0 with tensorboard-data-server 0.7.2, which pip installs with it on Linux.
#
# What one expects: the same curves with both of its readers of event files. A program that goes on
# from an earlier checkpoint writes SessionLog.START with the next step, and TensorBoard drops the
# points from that step on. A point that comes late, such as an evaluation that took longer than
# another, is one more point.
# What happens: the fast reader, which is used by default where it is installed, ignores
# SessionLog.START: curves that have no new point yet keep those of the abandoned steps. And any point
# removes all points of its curve with the same or a later step, so that one that comes late
# deletes what was shown already.
# What helps: tensorboard --load_fast=false.
#
# Output seen (steps of each curve, after START with step 5):
#
#   fast reader: rewards 1 2 3 4 5 6, evaluations 2 4 6 8, late point 1 2 3
#   slow reader: rewards 1 2 3 4 5 6, evaluations 2 4, late point 1 2 3 4 5
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "tensorboard==2.21.0" "tensorboard-data-server==0.7.2"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import json
import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request

from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter


def point(time_s: float, step: int, tag: str) -> Event:
    value = Summary.Value(tag=tag, simple_value=1.0)
    return Event(wall_time=time_s, step=step, summary=Summary(value=[value]))


def start(time_s: float, step: int) -> Event:
    return Event(wall_time=time_s, step=step, session_log=SessionLog(status=SessionLog.START))


def write(began_s: int, events: list[Event]) -> None:
    os.makedirs("logs", exist_ok=True)
    with open(f"logs/events.out.tfevents.{began_s:010d}.host.1.1", "wb") as file:
        writer = RecordWriter(file)
        for event in (Event(wall_time=began_s, file_version="brain.Event:2"), *events):
            writer.write(event.SerializeToString())


first = [start(1, 0)]
for step in range(1, 9):
    first.append(point(10 + step, step, "rewards"))
    if step % 2 == 0:
        first.append(point(10 + step, step, "evaluations"))
write(1, first)
late = [point(40 + number, step, "late point") for number, step in enumerate((1, 2, 4, 5, 3))]
write(30, [start(30, 5), point(31, 5, "rewards"), point(32, 6, "rewards"), *late])


def shown(port: int, tag: str) -> list[int]:
    query = urllib.parse.urlencode({"run": ".", "tag": tag})
    address = f"http://127.0.0.1:{port}/data/plugin/scalars/scalars?{query}"
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return sorted(step for _, step, _ in json.load(answer))
    except (urllib.error.URLError, OSError):
        return []


def curves(fast: str) -> dict[str, list[int]]:
    """Steps of all curves, once they have not changed for five seconds."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
    command = [sys.executable, "-m", "tensorboard.main", "--logdir", "logs", "--host", "127.0.0.1"]
    command += ["--port", str(port), "--load_fast", fast]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        seen, same = {}, 0
        for _ in range(90):
            time.sleep(1)
            now = {tag: shown(port, tag) for tag in ("rewards", "evaluations", "late point")}
            same = same + 1 if now == seen and all(now.values()) else 0
            seen = now
            if same == 5:
                break
        return seen
    finally:
        server.terminate()
        server.wait()


WANTED = {
    "fast": [[1, 2, 3, 4, 5, 6], [2, 4, 6, 8], [1, 2, 3]],
    "slow": [[1, 2, 3, 4, 5, 6], [2, 4], [1, 2, 3, 4, 5]],
}
good = True
for name, fast in (("fast", "true"), ("slow", "false")):
    found = curves(fast)
    told = ", ".join(f"{tag} {' '.join(map(str, steps))}" for tag, steps in found.items())
    print(f"{name} reader: {told}")
    good = good and list(found.values()) == WANTED[name]
if not good:
    raise SystemExit("The behaviour has changed.")
PYTHON
