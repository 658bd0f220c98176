"""Where the time of the workers goes: a flame graph of the main thread of each process.

    python scripts/bench flame FOLDER [--run-id 0] [--seconds 20] --picture FILE.png

FOLDER is a working folder in which a training runs. Needs py-spy (`pip install py-spy`), which
looks into another process 200 times a second. Each bar is a function, the bars above it are what it
calls, and the width is its share of the time, with waiting. Other threads are left out: uploads,
downloads, halves of a minibatch.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.axes import Axes

RATE_HZ = 200
NARROWEST, NARROWEST_LABEL = 0.004, 0.03
"""Shares of the width below which a bar is left out, or has no label."""

MOST_LEVELS = 18

COLOURS = {"drcli/": "#f0a35e", "drsim/": "#e8c468", "torch/": "#7fb2d9", "botocore/": "#9ccf8f"}
OTHER_COLOUR = "#cfcfcf"


@dataclass
class Bar:
    """A function in a flame graph.

    Attributes:
        samples: How often it was seen at this place.
        above: What it called, by label.
    """

    samples: int = 0
    above: dict[str, "Bar"] = field(default_factory=dict)


def main() -> None:
    """Record all workers at the same time, and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="working folder of a running training")
    parser.add_argument("--run-id", default="0", help="DR_RUN_ID")
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--picture", type=Path, required=True, help="PNG to write")
    options = parser.parse_args()
    program = shutil.which("py-spy")
    if program is None:
        sys.exit("py-spy is not installed: pip install py-spy")
    record = options.folder / "data" / "runs" / options.run_id / "run.json"
    workers = json.loads(record.read_text())["workers"]
    how = [f"--duration={options.seconds}", f"--rate={RATE_HZ}", "--function", "--threads"]
    recordings = {
        worker["name"]: subprocess.Popen(
            [program, "record", f"--pid={worker['pid']}", *how, "--format=raw", "-o/dev/stdout"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        for worker in workers
    }
    graphs = {name: bars_of(process.communicate()[0]) for name, process in recordings.items()}
    draw(graphs, options.picture)
    for name, bars in graphs.items():
        print(f"{name}: {bars.samples} samples")


def bars_of(recording: str) -> Bar:
    """The main thread of a recording in py-spy's raw format, from the worker's loop on.

    Each line has functions from the outermost to the innermost, and how often they were seen.
    """
    bars = Bar()
    for line in recording.splitlines():
        stack, _, count = line.rpartition(" ")
        functions = stack.split(";")
        starts = [
            i for i, name in enumerate(functions) if re.search(r"workers/worker_process", name)
        ]
        if not starts:
            continue  # another thread
        bar = bars
        bar.samples += int(count)
        for name in functions[starts[-1] + 1 :][:MOST_LEVELS]:
            bar = bar.above.setdefault(name, Bar())
            bar.samples += int(count)
    return bars


def draw(graphs: dict[str, Bar], picture: Path) -> None:
    """Write the flame graphs of all workers, one below the other."""
    figure, parts = pyplot.subplots(len(graphs), 1, figsize=(14, 5 * len(graphs)), squeeze=False)
    for (name, bars), axes in zip(graphs.items(), parts[:, 0], strict=True):
        axes.set_title(f"{name}, main thread", loc="left")
        axes.set_xlim(0, 1)
        axes.set_ylim(0, MOST_LEVELS)
        axes.set_axis_off()
        if bars.samples:
            _draw_above(axes, bars, 0.0, 0, bars.samples)
    figure.tight_layout()
    figure.savefig(picture, dpi=100)
    pyplot.close(figure)


def _draw_above(axes: Axes, bar: Bar, left: float, level: int, total: int) -> None:
    for name, each in sorted(bar.above.items()):
        width = each.samples / total
        if width >= NARROWEST:
            colour = next((c for part, c in COLOURS.items() if part in name), OTHER_COLOUR)
            axes.barh(level, width, 0.94, left, align="edge", color=colour, edgecolor="white")
            if width >= NARROWEST_LABEL:
                text = f"{name.split(' (')[0]} {width:.0%}"
                most = int(width * 190)
                axes.text(
                    left + 0.002,
                    level + 0.47,
                    text if len(text) <= most else text[: most - 1] + "…",
                    fontsize=7,
                    va="center",
                    clip_on=True,
                )
            _draw_above(axes, each, left, level + 1, total)
        left += width


if __name__ == "__main__":
    main()
