"""Draws the curves of scale.py."""

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot

CURVES = {
    "steps/s": "scale-steps.png",
    "learner idle %": "scale-idle.png",
    "USD per million steps": "scale-cost.png",
}


def draw(curves: dict[str, list[dict[str, Any]]], folder: Path) -> None:
    """Write a picture for each of `CURVES` into a folder."""
    for value, name in CURVES.items():
        figure, axes = pyplot.subplots(figsize=(6.4, 3.6), dpi=110)
        for case, rows in curves.items():
            axes.plot(
                [row["workers"] for row in rows],
                [row[value] for row in rows],
                marker="o",
                markersize=3,
                label=case,
            )
        axes.set_xscale("log")
        if value != "learner idle %":
            axes.set_yscale("log")
        axes.set_xlabel("workers")
        axes.set_ylabel(value)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
        figure.tight_layout()
        figure.savefig(folder / name)
        pyplot.close(figure)
