"""How long commands take that do not train. Prints JSON.

    python scripts/bench startup [--repeat 10]

Each command runs several times in a new working folder in which nothing was started, and the
shortest times count. On a busy machine, compare `cpu_s`; on an idle one, `wall_s` is how long a
user waits.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

from machine import print_json

from drcli.bucket.server import server
from drcli.cli.completion import ASKS, LINE
from drcli.config.new_folder import plan_folder, write

BAR_S, HELP_BAR_S = 0.4, 0.3
"""Longest time for a command or an answer to the Tab key, and for help."""

COMMANDS = (
    "--help",
    "start-training --help",
    "status --help",
    "status",
    "status --json",
    "summary",
    "logs trainer",
    "config show",
    "config check --settings",
    "config set DR_RUN_ID=0",
    "stop-training",
    "list-models",
    "url",
    "tracks list",
    "init other",
    "shell-env",
    "completion show bash",
)

COMPLETIONS = (
    "dr st",
    "dr-status --",
    "dr-tracks show re",
    "dr-config set DR_WOR",
    "dr-increment-training -p m",
)


@dataclass(frozen=True)
class Measured:
    """The shortest times of several calls.

    Attributes:
        call: The command line.
        cpu_s: Processor time, user and system.
        wall_s: Wall time.
        bar_s: Longest time allowed.
    """

    call: str
    cpu_s: float
    wall_s: float
    bar_s: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=10, help="calls of each command")
    repeat = parser.parse_args().repeat
    with tempfile.TemporaryDirectory() as folder, ExitStack() as afterwards:
        afterwards.callback(server.stop_default, Path(folder))  # list-models starts a server
        write(plan_folder(Path(folder), {}))
        measured = [
            *(measure(call, call.split(), {}, folder, repeat) for call in COMMANDS),
            *(measure(f"Tab: {line}", [], question(line), folder, repeat) for line in COMPLETIONS),
        ]
    late = [one.call for one in measured if one.wall_s > one.bar_s]
    report = {"calls": [asdict(one) for one in measured], "over_the_bar": late}
    print_json(report, indent=1)


def question(line: str) -> dict[str, str]:
    """Variables by which a shell asks for the words that complete a line."""
    return {**ASKS, LINE: line}


def measure(
    call: str, arguments: list[str], variables: dict[str, str], folder: str, repeat: int
) -> Measured:
    """Call `dr` several times."""
    cpu_s, wall_s = zip(*(once(arguments, variables, folder) for _ in range(repeat)), strict=True)
    bar_s = HELP_BAR_S if "--help" in arguments else BAR_S
    return Measured(call, round(min(cpu_s), 3), round(min(wall_s), 3), bar_s)


def once(arguments: list[str], variables: dict[str, str], folder: str) -> tuple[float, float]:
    """Processor time and wall time of one call, seconds."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DR_")}
    started_s = time.perf_counter()
    process = subprocess.Popen(
        [str(Path(sys.executable).with_name("dr")), *arguments],
        cwd=folder,
        env={**kept, **variables},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, _, used = os.wait4(process.pid, 0)
    process.returncode = 0  # waited for already
    return used.ru_utime + used.ru_stime, time.perf_counter() - started_s


if __name__ == "__main__":
    main()
