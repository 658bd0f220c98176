"""Writes the graphs and maps of a report as PNG pictures."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.analysis import Analysis
from drcli.analysis.findings.action_use import ActionUse
from drcli.analysis.findings.driven_steps import EpisodeEnds
from drcli.analysis.report.driving_sections import reward_rate_section
from drcli.analysis.report.graphs import Graph, Series
from drcli.analysis.report.lap_choice import choose_laps
from drcli.analysis.report.map_section import bounds_of, ground_cells, located, with_motion
from drcli.analysis.report.summary_sections import lap_section, learner_section, reward_section
from drcli.analysis.run import Run
from drcli.base.files import make_picture_folder, refuse_replacing, rewrite
from drcli.base.installation import lazy_imports
from drcli.base.png_picture import INK, LINES, png

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

with lazy_imports():
    from matplotlib import collections

# Draws the track with what was driven on it.


_CELL_M = 0.1
_MAP_WIDTH_IN = 13.0
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
        _draw_ends_on_map(ends, steps, run.episodes)
        ends.set_title("Where episodes ended")
        for axes in (reward, speed, lines, ends):
            _draw_borders(axes, run)
            axes.set(xlim=box[::2], ylim=box[1::2], aspect="equal")
            axes.grid(False)
            axes.set_axis_off()

    return png(draw, (_MAP_WIDTH_IN, min(max(_MAP_WIDTH_IN * ratio, 5.0), 20.0) + 0.6))


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

    squares = collections.PolyCollection(
        corners.tolist(), array=means, cmap="viridis", edgecolors="face", linewidths=0.3
    )
    squares.set_clim(low, high if high > low else low + 1.0)
    axes.add_collection(squares)
    figure.colorbar(squares, ax=axes, label=label, shrink=0.6, aspect=30)


def _draw_laps(axes: "Axes", steps: "pd.DataFrame", numbers: tuple[int, ...], color: str) -> None:
    for number in numbers:
        lap = steps[steps["unique_episode"] == number]
        axes.plot(lap["x"], lap["y"], color=color, linewidth=1.4, alpha=0.8)


def _draw_ends_on_map(axes: "Axes", steps: "pd.DataFrame", episodes: "pd.DataFrame") -> None:
    last = steps.drop_duplicates("unique_episode", keep="last").set_index("unique_episode")
    status = episodes["status"].astype(str).reindex(last.index)
    for name in sorted(status.unique()):
        where = last[status == name]
        color = _ENDS.get(name, "#8b949e")
        text = f"{name.replace('_', ' ')} ({len(where)})"
        axes.plot(where["x"], where["y"], "o", color=color, ms=4.0, mew=0, alpha=0.7, label=text)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, frameon=False)


_WIDTH_IN, _HEIGHT_IN = 11.0, 3.6
_COLORS = dict(zip(("--c1", "--c2", "--c3", "--c4", "--c5"), LINES, strict=False)) | {
    "--c6": "#4d4dad",
    "--dots1": LINES[0],
    "--dots2": LINES[1],
    "--dots3": LINES[2],
}
_OTHER = "#8b949e"


def write_pngs(analysis: Analysis, folder: Path, *, force: bool = False) -> tuple[Path, ...]:
    """Write the pictures of an analysis into a folder, which is made if missing.

    Raises:
        SettingsError: One cannot be written, or exists and `force` is not given.
    """
    make_picture_folder(folder)
    pictures = {folder / name: draw for name, draw in _pictures(analysis)}
    for path in pictures:
        refuse_replacing(path, force=force)
    for path, draw in pictures.items():
        rewrite(path, draw())
    return tuple(pictures)


def _pictures(analysis: Analysis) -> Iterator[tuple[str, Callable[[], bytes]]]:
    run, found = analysis.run, analysis.evidence
    sections = {
        "reward.png": reward_section(run),
        "laps.png": lap_section(run),
        "reward-rate.png": reward_rate_section(run, found.rate),
        "learner.png": learner_section(run),
    }
    for name, section in sections.items():
        if section is not None and section.graphs:
            yield name, partial(_draw_graphs, section.graphs, run.name)
    if np.isfinite(run.steps[["x", "y"]].to_numpy(np.float64)).all(axis=1).any():
        yield "track.png", partial(draw_maps, run)
    if found.ends is not None and found.ends.parts:
        yield "ends.png", partial(_draw_ends, found.ends, run.name)
    if found.actions is not None:
        yield "actions.png", partial(_draw_actions, found.actions, run.name)


def _draw_graphs(graphs: Sequence[Graph], title: str) -> bytes:
    def draw(figure: "Figure") -> None:
        figure.suptitle(title, x=0.01, ha="left", size=14)
        axes = np.atleast_1d(figure.subplots(len(graphs)))
        for graph, room in zip(graphs, axes, strict=True):
            _draw_graph(graph, room)

    height_in = max(_HEIGHT_IN * len(graphs), 5.0) + 0.4
    return png(draw, (_WIDTH_IN, height_in))


def _draw_graph(graph: Graph, left: "Axes") -> None:
    used = {one.axis for one in graph.series}
    right = left.twinx() if "right" in used else None
    handles = []
    for one in graph.series:
        axes = right if one.axis == "right" and right is not None else left
        handles += _draw_series(one, axes)
    left.set_title(graph.title)
    left.set(xlabel=graph.x_label, ylabel=graph.left)
    if graph.left_range:
        left.set_ylim(*graph.left_range)
    if right is not None:
        right.set_ylabel(graph.right)
        right.spines["right"].set_visible(True)
        right.grid(False)
        if graph.right_range:
            right.set_ylim(*graph.right_range)
    for mark in graph.marks:
        left.axvline(mark.x, color=LINES[2], linestyle="--", linewidth=1.2)
        left.annotate(
            mark.label,
            (mark.x, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(4, -2),
            textcoords="offset points",
            va="top",
            color=LINES[2],
        )
    if len(handles) > 1:
        left.legend(
            handles=handles, loc="upper left", bbox_to_anchor=(0.0, -0.17), ncols=3, frameon=False
        )


def _draw_series(series: Series, axes: "Axes") -> list[object]:
    if not series.on:
        return []
    x, y = np.asarray(series.x, np.float64), np.asarray(series.y, np.float64)
    known = np.isfinite(x) & np.isfinite(y)
    color = _COLORS.get(series.color, INK)
    if series.kind == "line":
        mark = "o" if known.sum() < 3 else ""
        return list(
            axes.plot(x[known], y[known], color=color, lw=2.0, marker=mark, label=series.name)
        )
    size, alpha = (6.0, 0.9) if series.kind == "marks" else (3.5, 0.35)
    return list(
        axes.plot(
            x[known], y[known], "o", color=color, ms=size, alpha=alpha, mew=0, label=series.name
        )
    )


def _draw_ends(ends: EpisodeEnds, title: str) -> bytes:
    names = [f"{part.first}-{part.last}" for part in ends.parts]
    counts = [part.ends for part in ends.parts]

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        figure.suptitle(title, x=0.01, ha="left", size=14)
        colors = [LINES[1] if number == ends.worst else LINES[0] for number in range(len(names))]
        axes.bar(range(len(names)), counts, color=colors)
        axes.set_xticks(range(len(names)), names, rotation=60, ha="right")
        axes.set_title(
            f"Where episodes end, late in the training: {ends.episodes} episodes, "
            f"{ends.complete} clean laps"
        )
        axes.set(xlabel="waypoints", ylabel="episodes that end there")

    return png(draw, (_WIDTH_IN, 4.6))


def _draw_actions(use: ActionUse, title: str) -> bytes:
    names = [f"{one.steering_deg:.3g}°\n{one.speed_mps:.2g} m/s" for one in use.actions]
    at = np.arange(len(names))

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        figure.suptitle(title, x=0.01, ha="left", size=14)
        late = [100 * one.share for one in use.actions]
        early = [100 * one.early_share for one in use.actions]
        axes.bar(at - 0.2, early, 0.38, color=_OTHER, label="first third of the training")
        axes.bar(at + 0.2, late, 0.38, color=LINES[0], label="late in the training")
        axes.set_xticks(at, names, size=9)
        for number in use.dead:
            axes.get_xticklabels()[number].set_color(LINES[1])
        axes.set_title("Use of the actions" + (": dead ones in orange" if use.dead else ""))
        axes.set(xlabel="steering (left is positive) and speed", ylabel="share of the steps (%)")
        axes.legend(frameon=False)

    return png(draw, (max(_WIDTH_IN, 0.62 * len(names)), 4.6))
