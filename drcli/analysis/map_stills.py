"""Draws the track with what was driven on it."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drcli.analysis.report.lap_choice import choose_laps
from drcli.analysis.report.map_data import bounds_of, ground_cells
from drcli.analysis.report.map_laps import located, with_motion
from drcli.analysis.run import Run
from drcli.base.png_picture import INK, LINES, png

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_CELL_M = 0.1
_WIDTH_IN = 13.0
_ENDS = {
    "lap_complete": LINES[2],
    "off_track": LINES[1],
    "crashed": LINES[3],
    "reversed": "#7a6bd8",
    "immobilized": LINES[4],
}


def draw_maps(run: Run) -> bytes:
    steps = with_motion(located(run.steps))
    laps = choose_laps(run.episodes)
    late_episodes = run.episodes.index[run.episodes["quintile"].astype(str).str[0] == "5"]
    late = steps[steps["unique_episode"].isin(late_episodes)]
    late = late[late["episode_status"] != "prepare"]
    late = steps if late.empty else late
    box = bounds_of(steps, run.track)
    ratio = (box[3] - box[1]) / (box[2] - box[0])

    def draw(figure: "Figure") -> None:
        figure.suptitle(
            f"{run.name} on {run.world or 'a track that is not known'}", x=0.01, ha="left", size=14
        )
        (reward, speed), (lines, ends) = figure.subplots(2, 2)
        _draw_means(figure, reward, late, "reward", "reward of a step")
        reward.set_title("Reward of a step, last fifth of the training")
        _draw_means(figure, speed, late, "driven", "m/s")
        speed.set_title("Driven speed, last fifth of the training")
        _draw_laps(lines, steps, laps.worst, LINES[1])
        _draw_laps(lines, steps, laps.fastest, LINES[0])
        lines.set_title("Fastest laps (blue), worst of the last fifth (orange)")
        _draw_ends(ends, steps, run.episodes)
        ends.set_title("Where episodes ended")
        for axes in (reward, speed, lines, ends):
            _draw_borders(axes, run)
            axes.set(xlim=box[::2], ylim=box[1::2], aspect="equal")
            axes.grid(False)
            axes.set_axis_off()

    return png(draw, (_WIDTH_IN, min(max(_WIDTH_IN * ratio, 5.0), 20.0) + 0.6))


def _draw_borders(axes: "Axes", run: Run) -> None:
    if run.track is None:
        return
    for border in (run.track.inner, run.track.outer):
        line = np.concatenate([border, border[:1]]) if run.track.closed else border
        axes.plot(*line.T, color=INK, linewidth=0.9, zorder=3)


def _draw_means(
    figure: "Figure", axes: "Axes", steps: "pd.DataFrame", column: str, label: str
) -> None:
    values = steps[column].to_numpy(np.float64)
    known = np.isfinite(values)
    if not known.any():
        return
    xy = steps[["x", "y"]].to_numpy(np.float64)[known]
    cells, cell = ground_cells(xy, _CELL_M)
    means = np.bincount(cell, weights=values[known]) / np.bincount(cell)
    low, high = np.percentile(values[known], [2.0, 98.0])
    at = (cells + 0.5) * _CELL_M
    half = _CELL_M / 2
    corners = at[:, None, :] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    from matplotlib.collections import PolyCollection

    squares = PolyCollection(
        corners.tolist(), array=means, cmap="viridis", edgecolors="face", linewidths=0.3
    )
    squares.set_clim(low, high if high > low else low + 1.0)
    axes.add_collection(squares)
    figure.colorbar(squares, ax=axes, label=label, shrink=0.6, aspect=30)


def _draw_laps(axes: "Axes", steps: "pd.DataFrame", numbers: tuple[int, ...], color: str) -> None:
    for number in numbers:
        lap = steps[steps["unique_episode"] == number]
        axes.plot(lap["x"], lap["y"], color=color, linewidth=1.4, alpha=0.8)


def _draw_ends(axes: "Axes", steps: "pd.DataFrame", episodes: "pd.DataFrame") -> None:
    last = steps.drop_duplicates("unique_episode", keep="last").set_index("unique_episode")
    status = episodes["status"].astype(str).reindex(last.index)
    for name in sorted(status.unique()):
        where = last[status == name]
        color = _ENDS.get(name, "#8b949e")
        text = f"{name.replace('_', ' ')} ({len(where)})"
        axes.plot(where["x"], where["y"], "o", color=color, ms=4.0, mew=0, alpha=0.7, label=text)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, frameon=False)
