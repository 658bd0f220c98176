"""What terminals show: real pseudo terminals of several kinds and sizes, and pipes.

Screens are recorded in `screens/`. After an intended change, read the difference and record
them again with RECORD_SCREENS=1.
"""

import json
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Mapping
from fcntl import ioctl
from pathlib import Path

import pyte
import pytest

from drcli.model import keys
from drcli.records.run_record import RunRecord, WorkerRecord

SCREENS = Path(__file__).parent / "screens"
PATIENCE_S = 60.0

ESCAPES = re.compile(r"\x1b(?:\[[0-9;?]*[A-Za-z]|[()][A-Z0-9]|[=>78])")
COLOURS = re.compile(r"\x1b\[(?:[0-9;]*;)?(?:3[0-8]|4[0-8]|9[0-7]|10[0-7])(?:;[0-9;]*)?m")
STYLES = re.compile(r"\x1b\[[0-9;]*m")

COMMANDS = {
    "help": ["--help"],
    "help-start-training": ["start-training", "--help"],
    "status": ["status"],
    "summary": ["summary"],
    "tracks": ["tracks", "list"],
    "no-such-command": ["statsu"],
    "wrong-value": ["config", "set", "DR_WORKERS=many"],
}

SLOW = "tracks"
"""Loads the simulation, so it is shown where sizes matter only."""

SHOW = """
import sys
from drcli.cli.app import main
for name, arguments in COMMANDS.items():
    for stream in (sys.stdout, sys.stderr):
        print(f"== {name}", file=stream, flush=True)
    try:
        main(arguments)
    except SystemExit:
        pass
"""
"""Many commands in one process: starting one for each would take most of the time."""

ALL = f"COMMANDS = {COMMANDS!r}{SHOW}"
QUICK = f"COMMANDS = { {k: v for k, v in COMMANDS.items() if k != SLOW}!r}{SHOW}"

ASKED = """
from drcli.cli import terminal
print("live:", terminal.is_live(), flush=True)
"""

LIVE = """
from pathlib import Path
from drcli.cli import follow_training as watching
from drcli.config.loading import load_settings
from drcli.run.status import inspect
from dataclasses import replace
report = inspect(load_settings(Path.cwd()).run)
workers = [replace(worker, activity="drives iteration 9") for worker in report.workers]
report = replace(report, state="running", message="", workers=workers)
watching.time.time = lambda: report.started_at + 75.0
with watching.live(verbose=False) as show:
    for shown in (3, 6, len(report.history)):
        show(replace(report, history=report.history[:shown]))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A working folder in which a training has ended; nothing has to run to look at it."""
    folder = tmp_path_factory.mktemp("racer")
    (folder / "system.env").write_text("DR_CLOUD=local\n")
    (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
    record = RunRecord(
        **{"run_id": 0, "session": "s", "bucket": "bucket", "prefix": "model"},
        **{"world": "reinvent_base", "state": "finished", "pid": 4242, "pid_started": 1.0},
        **{"started_at": 1_000_000.0, "ended_at": 1_000_060.0, "exit_code": 0},
        message="All 3 evaluation laps are complete.",
        workers=[WorkerRecord(name, 4243, 0) for name in ("trainer", "sim-0")],
    )
    record.write(folder / "data" / "runs" / "0")
    iterations = [iteration(n) for n in range(9)]
    checkpoints = {
        f"{which}_checkpoint": {"name": name, "avg_eval_metric": metric}
        for which, name, metric in (
            ("best", "8_Step-4000.ckpt", 100.0),
            ("last", "9_Step-4500.ckpt", None),
        )
    }
    for key, value in (
        (keys.history("model"), {"iterations": iterations}),
        (keys.deepracer_checkpoints("model"), checkpoints),
    ):
        path = folder / "data" / "s3" / "bucket" / key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(value))
    return folder


def iteration(n: int) -> dict[str, object]:
    """Iteration n of a training that gets better by 9 % each time."""
    laps = max(0, min(3, n - 5))
    return {
        **{"iteration": n, "checkpoint": f"{n}_Step-{n * 500}.ckpt", "episodes": 20},
        **{"steps": 500, "total_steps": (n + 1) * 500, "mean_reward": 10.0 + 4.0 * n},
        **{"mean_progress": 10.0 + 9.0 * n, "full_laps": n, "best_lap_s": 14.25 if n else None},
        **{"entropy": 2.5 - 0.05 * n, "surrogate_loss": -0.0123, "value_loss": 0.45, "kl": 0.0021},
        **{"steps_per_s": 370.0, "real_time_factor": 25.0, "drive_s": 0.6, "learn_s": 0.7},
        **{"exchange_s": 0.1, "elapsed_s": 1.4 * (n + 1)},
        "evaluation_progress": [100.0] * laps + [40.0] * (3 - laps),
        "evaluation_lap_s": [14.5] * laps,
    }


def environment(**more: str) -> dict[str, str]:
    """Ours, without what says how to print."""
    doubtful = {"NO_COLOR", "FORCE_COLOR", "TERM", "COLORTERM", "COLUMNS", "LINES"}
    kept = {k: v for k, v in os.environ.items() if k not in doubtful and not k.startswith("DR_")}
    return {**kept, "LC_ALL": "C.UTF-8", **more}


def in_terminal(program: str, folder: Path, size: tuple[int, int], **variables: str) -> str:
    """All that a program writes to a terminal of so many columns and rows."""
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=folder,
        env=environment(**{"TERM": "xterm-256color", **variables}),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)
    written, deadline = b"", time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if not select.select([ours], [], [], 1.0)[0]:
            continue
        try:
            piece = os.read(ours, 65536)
        except OSError:  # how Linux says that nobody writes any more
            break
        if not piece:
            break
        written += piece
    os.close(ours)
    assert process.wait(PATIENCE_S) == 0, written.decode()
    return written.decode().replace(str(folder), "FOLDER")


def in_pipe(program: str, folder: Path, **variables: str) -> Mapping[str, str]:
    """What a program writes to two pipes, by name of the stream."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env=environment(**variables),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    return {"stdout": done.stdout, "stderr": done.stderr}


def parts(written: str) -> dict[str, str]:
    """Output of each command, by its name."""
    pieces = re.split(r"^== (\S+)\r?\n", written, flags=re.MULTILINE)
    found: dict[str, str] = {}
    for name, text in zip(pieces[1::2], pieces[2::2], strict=True):
        found[name] = found.get(name, "") + text
    return found


def screen(written: str, size: tuple[int, int]) -> str:
    """What somebody sees who scrolls back to the beginning."""
    terminal = pyte.Screen(size[0], 400)
    pyte.Stream(terminal).feed(written)
    return "\n".join(line.rstrip() for line in terminal.display).rstrip() + "\n"


def compare(name: str, seen: str) -> None:
    """A screen with the recorded one."""
    file = SCREENS / f"{name}.txt"
    if os.environ.get("RECORD_SCREENS"):
        file.parent.mkdir(exist_ok=True)
        file.write_text(seen, "utf-8")
    assert seen == file.read_text("utf-8")


@pytest.fixture(scope="module", params=[(80, 24), (200, 60)], ids=["80x24", "200x60"])
def sized(request, folder) -> tuple[tuple[int, int], dict[str, str]]:
    """A size, and what each command writes to a terminal of that size."""
    return request.param, parts(in_terminal(ALL, folder, request.param))


def test_nothing_is_wider_than_the_terminal(sized):
    size, written = sized

    for name in ("help", "help-start-training", "status", "summary", "tracks"):
        lines = ESCAPES.sub("", written[name]).splitlines()
        assert max(map(len, lines)) <= size[0], name


@pytest.mark.parametrize("name", ["status", "tracks", "no-such-command", "wrong-value"])
def test_a_screen_is_as_recorded(sized, name):
    size, written = sized

    compare(f"{name}-{size[0]}x{size[1]}", screen(written[name], size))


def test_a_terminal_gets_colours(sized):
    _, written = sized

    assert COLOURS.search(written["wrong-value"])


@pytest.mark.parametrize("size", [(40, 24), (80, 24), (200, 60)], ids=["40x24", "80x24", "200x60"])
def test_the_live_display_is_drawn_in_place_and_fits(folder, size):
    written = in_terminal(ASKED + LIVE, folder, size)

    seen = screen(written, size)
    assert seen.startswith("live: True\n")
    assert len(seen.splitlines()) == size[1]
    compare(f"live-{size[0]}x{size[1]}", seen)


@pytest.mark.parametrize("variables", [{"NO_COLOR": "1"}, {"TERM": "dumb"}], ids=str)
def test_without_colours_there_is_no_escape_sequence_at_all(folder, variables):
    written = in_terminal(QUICK + ASKED, folder, (80, 24), **variables)

    assert "\x1b" not in written
    assert "live: False" in written
    assert "Try:" in written


def test_a_pipe_gets_text_results_apart_from_words(folder):
    written = in_pipe(QUICK, folder)

    assert "\x1b" not in written["stdout"] + written["stderr"]
    assert "\r" not in written["stdout"] + written["stderr"]
    assert "All 3 evaluation laps are complete." in parts(written["stdout"])["status"]
    assert parts(written["stdout"])["wrong-value"] == ""
    assert "Error: " in parts(written["stderr"])["wrong-value"]


def test_forced_colours_do_not_make_a_pipe_a_terminal(folder):
    written = in_pipe(QUICK + ASKED, folder, FORCE_COLOR="1")

    text = written["stdout"] + written["stderr"]
    assert COLOURS.search(text)
    assert "\x1b" not in STYLES.sub("", text)
    assert "live: False" in text
