"""Maps and curves of rewards."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import refuse
from drcli.base.files import refuse_replacing, rewrite
from drcli.base.installation import lazy_imports
from drcli.base.png_picture import INK, LINES, png
from drcli.base.report import View, bold, compact
from drcli.config.settings import Settings
from drcli.rewards.course import FAST, STEADY, Trip
from drcli.rewards.scripted_drive import drive, own_actions
from drcli.rewards.source import read_racers_file
from drcli.rewards.track_grid import SPEED_MPS, DrivenCourse
from drcli.rewards.tried_reward import TriedReward, as_array, scaled, try_rewards
from drsim.track.track import Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

with lazy_imports():
    import matplotlib
    from matplotlib import collections, patches, patheffects

Floats = NDArray[np.float64]

_WIDTH_IN = 14.0
_UNKNOWN = "#cdcfd1"

_MARKS = (0.25, 0.5, 0.75)
_FINISH = 2.0
"""More would flatten all curves."""


@dataclass(frozen=True)
class Curve:
    """Percent, and values or NaN, of shape (n,)."""

    name: str
    color: str
    progress: Floats
    values: Floats
    style: str = "-"


def draw_reward(driven: DrivenCourse, tried: TriedReward) -> bytes:
    drive = driven.drive
    map_in = _map_height_in(drive.track, _WIDTH_IN - 1.6)
    values = tried.grid_values
    curves = [
        _curve_of(tried, trip, color)
        for trip, color in zip(drive.trips, itertools.cycle(LINES), strict=False)
    ]
    low, high, cut = curve_range(curves)

    def draw(figure: "Figure") -> None:
        upper, lower = figure.subplots(2, height_ratios=[map_in, 3.2])
        figure.suptitle(
            f"{tried.name} on {drive.world}, {drive.race_type}", x=0.01, ha="left", size=15
        )
        _draw_map(upper, driven, values)
        upper.set_title(
            f"Reward of a car that is at this place, points along the track and requests "
            f"{SPEED_MPS:g} m/s"
        )
        _draw_curves(lower, curves, low, high)
        lower.set_title(f"Reward of each driver along the lap, and its sum{cut}")
        lower.set_ylabel("reward per step")

    return png(draw, (_WIDTH_IN, map_in + 4.9))


def draw_comparison(driven: DrivenCourse, first: TriedReward, second: TriedReward) -> bytes:
    drive = driven.drive
    map_in = max(_map_height_in(drive.track, _WIDTH_IN / 2 - 1.4), 3.4)
    a, b = first.grid_values, second.grid_values

    def draw(figure: "Figure") -> None:
        (left, right), (difference, lower) = figure.subplots(2, 2)
        figure.suptitle(
            f"A: {first.name}     B: {second.name}\non {drive.world}, {drive.race_type}",
            x=0.01,
            ha="left",
            size=14,
        )
        _draw_map(left, driven, a)
        left.set_title(f"A: reward of a car that requests {SPEED_MPS:g} m/s")
        _draw_map(right, driven, b)
        right.set_title("B: the same")
        _draw_map(difference, driven, scaled(b, b) - scaled(a, a), is_difference=True)
        difference.set_title("Red: B pays more. Blue: A pays more.")
        _draw_curves(lower, _scaled_curves(first, second), 0.0, 1.0)
        lower.set_title("Reward along the lap, and its sum before scaling")
        lower.set_ylabel("reward, scaled to 0..1")

    return png(draw, (_WIDTH_IN, 2 * map_in + 3.4))


def curve_range(curves: Sequence[Curve]) -> tuple[float, float, str]:
    """Values to show, and a note if the finish is cut off."""
    values = np.concatenate([curve.values for curve in curves])
    finish = np.concatenate([curve.progress for curve in curves]) >= 100.0
    known = ~np.isnan(values)
    if not known.any():
        return 0.0, 1.0, ""
    low, high = float(values[known].min()), float(values[known].max())
    before = values[known & ~finish]
    if len(before) and finish[known].any():
        usual = float(before.max())
        if high - low > _FINISH * (usual - min(low, float(before.min()))) > 0:
            return low, usual, f" (not shown: the finish pays up to {number(high)})"
    return low, high, ""


def number(value: float) -> str:
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    return f"{value:.2g}"


def _draw_map(
    axes: "Axes", driven: DrivenCourse, values: Floats, *, is_difference: bool = False
) -> None:
    grid, drive = driven.grid, driven.drive
    track = drive.track
    known = values[~np.isnan(values)]
    if is_difference:
        low, high, colors, label = -1.0, 1.0, "RdBu_r", "B minus A, both scaled to 0..1"
    else:
        colors, label = "viridis", "reward per step"
        # A few extremes have the same colour as the values next to them.
        low, high = np.percentile(known, [0.5, 99.5]).tolist() if len(known) else (0.0, 0.0)
    edges = cell_edges(grid.xy)
    if track.closed:
        edges = np.concatenate([edges, edges[:, :1]], axis=1)
    corners = [edges[:-1, :-1], edges[:-1, 1:], edges[1:, 1:], edges[1:, :-1]]
    areas = np.stack(corners, axis=2)
    # From the outside in: if parts of the track are close together, the road is on top.
    order = np.argsort(-np.abs(np.arange(len(values)) - len(values) // 2), kind="stable")
    shown = values[order, : areas.shape[1]].reshape(-1)
    cells = collections.PolyCollection(
        areas[order].reshape(-1, 4, 2).tolist(),
        array=np.ma.masked_invalid(shown),
        cmap=matplotlib.colormaps[colors].with_extremes(bad=_UNKNOWN),
        edgecolors="face",
        linewidths=0.4,
    )
    cells.set_clim(low, high)
    axes.add_collection(cells)
    for border in (track.inner, track.outer):
        line = np.concatenate([border, border[:1]]) if track.closed else border
        axes.plot(*line.T, color="white", linewidth=2.6)
        axes.plot(*line.T, color=INK, linewidth=1.1)
    for outline in grid.objects:
        axes.add_patch(
            patches.Polygon(outline, facecolor="white", edgecolor=INK, linewidth=1.6, zorder=3)
        )
    _draw_marks(axes, track, drive.start_fraction)
    low_x, low_y, high_x, high_y = track.bounds
    margin_m = _margin_m(track)
    axes.set(
        xlim=(low_x - margin_m, high_x + margin_m),
        ylim=(low_y - margin_m, high_y + margin_m),
        aspect="equal",
        xlabel="x (m)",
        ylabel="y (m)",
    )
    axes.grid(False)
    bar = axes.inset_axes((1.02, 0.0, 0.02, 1.0))
    axes.figure.colorbar(cells, cax=bar, label=label, extend="neither")


def _draw_marks(axes: "Axes", track: Track, start_fraction: float) -> None:
    halo = [patheffects.withStroke(linewidth=4.0, foreground="white")]
    for fraction in (0.0, *_MARKS):
        along_m = np.array([(start_fraction + fraction) % 1.0 * track.length_m])
        x, y, yaw_rad = track.pose_at(along_m)[0].tolist()
        width_m = float(track.locate(np.array([[x, y]])).track_width_m[0])
        ahead = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        left, here = np.array([-ahead[1], ahead[0]]), np.array([x, y])
        across = here + width_m * np.array([[-0.5], [0.5]]) * left
        start = fraction == 0.0
        axes.plot(*across.T, color="white", linewidth=4.5 if start else 2.0)
        axes.plot(*across.T, color=INK, linewidth=2.2 if start else 1.0)
        if start:
            axes.annotate(
                "",
                xy=tuple(here + 0.7 * ahead),
                xytext=tuple(here + 0.1 * ahead),
                arrowprops={
                    "arrowstyle": "-|>,head_width=0.35,head_length=0.7",
                    "color": INK,
                    "linewidth": 2.2,
                    "path_effects": halo,
                },
            )
        outward = left if _is_outside(track, here + 0.6 * width_m * left) else -left
        axes.annotate(
            "start" if start else f"{100 * fraction:.0f} %",
            xy=tuple(here + 0.85 * width_m * outward),
            xytext=tuple(15.0 * outward),
            textcoords="offset points",
            ha="center",
            va="center",
            color=INK,
            path_effects=halo,
        )


def _draw_curves(axes: "Axes", curves: Sequence[Curve], low: float, high: float) -> None:
    for curve in reversed(curves):
        progress, values = _with_gaps(curve)
        axes.plot(progress, values, curve.style, color=curve.color, lw=1.6, label=curve.name)
    span = high - low or 1.0
    axes.set(xlim=(0.0, 100.0), ylim=(low - 0.04 * span, high + 0.04 * span))
    axes.set_xticks([0.0, 25.0, 50.0, 75.0, 100.0], ["start", "25 %", "50 %", "75 %", "100 %"])
    axes.set_xlabel("progress")
    handles, names = axes.get_legend_handles_labels()
    axes.legend(
        handles[::-1],
        names[::-1],
        loc="upper left",
        bbox_to_anchor=(0.0, -0.16),
        ncols=2 if len(curves) == 4 else 3,
        frameon=False,
    )


def _curve_of(tried: TriedReward, trip: Trip, color: str) -> Curve:
    total = tried.total(trip.driver)
    earned = "" if total is None else f"{number(total)} "
    progress = np.array([call["progress"] for call in trip.calls])
    name = f"{trip.driver.name}: {earned}in {trip.seconds:.1f} s"
    return Curve(name, color, progress, as_array(tried.values(trip.driver)))


def _scaled_curves(first: TriedReward, second: TriedReward) -> list[Curve]:
    curves = []
    for name, tried, color in (("A", first, LINES[0]), ("B", second, LINES[1])):
        for driver, style in ((STEADY, "-"), (FAST, "--")):
            curve = _curve_of(tried, tried.trip(driver), color)
            values = scaled(curve.values, tried.drive_values)
            curves.append(Curve(f"{name} {curve.name}", color, curve.progress, values, style))
    return curves


def _with_gaps(curve: Curve) -> tuple[Floats, Floats]:
    steps = np.abs(np.diff(curve.progress))
    far = 6.0 * np.median(steps) + 1.0 if len(steps) else 0.0
    jumps = np.flatnonzero(steps > far) + 1
    return np.insert(curve.progress, jumps, np.nan), np.insert(curve.values, jumps, np.nan)


def _map_height_in(track: Track, width_in: float) -> float:
    low_x, low_y, high_x, high_y = track.bounds
    margin_m = 2 * _margin_m(track)
    shape = (high_y - low_y + margin_m) / (high_x - low_x + margin_m)
    return float(np.clip(width_in * shape, 0.3 * width_in, 0.62 * width_in))


def _margin_m(track: Track) -> float:
    return 1.1 * float(np.hypot(*(track.outer - track.inner).T).max())


def cell_edges(xy: Floats) -> Floats:
    """Shape (rows + 1, n, 2)."""
    between = (xy[:-1] + xy[1:]) / 2
    first, last = 2 * xy[:1] - between[:1], 2 * xy[-1:] - between[-1:]
    return np.concatenate([first, between, last])


def _is_outside(track: Track, point: Floats) -> bool:
    return bool(np.hypot(*(track.outer - point).T).min() < np.hypot(*(track.inner - point).T).min())


# Plots a reward function.


@dataclass(frozen=True)
class PlotReport:
    """A picture that was drawn."""

    file: Annotated[str, "The reward function."]
    world: Annotated[str, "The track."]
    picture: Annotated[str, "File of the picture."]
    replaced: Annotated[bool, "Whether it replaced an older file."]
    least: Annotated[float, "Least reward on the map."]
    greatest: Annotated[float, "Greatest reward on the map."]
    laps: Annotated[dict[str, float], "The sum of the rewards of each driver, by name."]

    def view(self) -> View:
        replaced = " (the old one was replaced)" if self.replaced else ""
        laps = ", ".join(f"{name} {compact(total)}" for name, total in self.laps.items())
        ends = f"{compact(self.least)} to {compact(self.greatest)}"
        return [
            ("Picture: ", bold(self.picture), replaced),
            f"{self.file} on {self.world}: {ends} per step on the map.",
            f"Sums: {laps}.",
        ]


def plot(
    settings: Settings, file: Path | None, out: Path, directory: Path, *, force: bool = False
) -> PlotReport:
    """As a PNG file.

    Raises:
        SettingsError: The function fails, or track or picture does.
    """
    read = read_racers_file(settings, file, directory)
    refuse_replacing(out, force=force)
    driven = DrivenCourse.of(drive(settings.race, own_actions(settings)))
    [tried] = try_rewards([read], driven.course, directory)
    refuse(tried.problems)
    replaced = out.exists()
    rewrite(out, draw_reward(driven, tried))
    values = tried.grid_values
    totals = {trip.driver.name: tried.total(trip.driver) for trip in tried.course.trips}
    return PlotReport(
        tried.name,
        tried.course.world,
        str(out),
        replaced,
        float(np.nanmin(values)),
        float(np.nanmax(values)),
        {name: total for name, total in totals.items() if total is not None},
    )
