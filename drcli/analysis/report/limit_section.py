"""Compares the fastest lap with the car's fastest line."""

import base64
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drcli.analysis.report.markup import Content, element
from drcli.analysis.report.section import Section
from drcli.analysis.run import Run
from drcli.base.png_picture import INK, LINES, png
from drcli.exchange.track_limit import (
    LapRow,
    LostPlace,
    limit_text,
    lost_places,
)
from drcli.tracks.limit_store import StoredLimit
from drsim.arrays import Floats
from drsim.limit.stations import points_of
from drsim.track.track import Track

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_WIDTH_IN = 10.0


class _Lap(NamedTuple):
    lap_s: float
    steps: "pd.DataFrame"


def _fastest_lap(run: Run) -> _Lap | None:
    clean = run.episodes[run.episodes["complete"].astype(bool)]
    if clean.empty:
        return None
    number = clean["time"].astype(float).idxmin()
    steps = run.steps[run.steps["unique_episode"] == number]
    return _Lap(float(clean.loc[number, "time"]), steps) if len(steps) > 1 else None


def limit_section(run: Run) -> Section | None:
    lap, track, limit = _fastest_lap(run), run.track, run.limit
    if lap is None or limit is None or track is None:
        return None
    places = _places(lap, track, limit)
    content: list[Content] = [element("p", f"The fastest lap, {limit_text(lap.lap_s, limit)}.")]
    if places:
        items = [element("li", str(place)) for place in places]
        content += [element("p", "Most time is lost at:"), element("ol", *items)]
    picture = base64.b64encode(_picture(track, limit, lap)).decode("ascii")
    caption = "The fastest line of this car, coloured by its speed, and the fastest lap over it"
    content.append(
        element(
            "figure",
            element("img", src=f"data:image/png;base64,{picture}", alt=caption, loading="lazy"),
            element("figcaption", caption),
        )
    )
    look = (
        "Look at where the lap leaves the line, and where it is slower: there the reward function "
        "pays for something else than time."
    )
    return Section("limit", "The fastest line", "Fastest line", look, tuple(content))


def _places(lap: _Lap, track: Track, limit: StoredLimit) -> list[LostPlace]:
    rows = [
        LapRow(float(progress), int(waypoint))
        for progress, waypoint in zip(
            lap.steps["progress"], lap.steps["closest_waypoint"], strict=True
        )
    ]
    first = lap.steps[["x", "y"]].to_numpy(np.float64)[:1]
    start = float(track.locate(first).distance_m[0]) / track.length_m
    return lost_places(rows, start - rows[0].progress % 100.0 / 100.0, limit)


def _picture(track: Track, limit: StoredLimit, lap: _Lap) -> bytes:
    line = points_of(track, np.array(limit.offset_mm) / 1000.0)
    speed: Floats = np.array(limit.speed_mmps) / 1000.0
    low_x, low_y, high_x, high_y = track.bounds

    def draw(figure: "Figure") -> None:
        from matplotlib.collections import LineCollection

        axes = figure.subplots()
        for border in (track.inner, track.outer):
            axes.plot(*border.T, color=INK, linewidth=0.9)
        ends = np.stack([line, np.roll(line, -1, axis=0)], axis=1)
        colored = LineCollection(ends.tolist(), array=speed, cmap="viridis", linewidths=5.0)
        axes.add_collection(colored)
        figure.colorbar(colored, ax=axes, label="m/s", shrink=0.7)
        axes.plot(lap.steps["x"], lap.steps["y"], color=LINES[1], linewidth=1.4)
        axes.set(aspect="equal")
        axes.grid(False)
        axes.set_axis_off()

    ratio = (high_y - low_y) / (high_x - low_x)
    return png(draw, (_WIDTH_IN, min(max(_WIDTH_IN * ratio, 3.0), 14.0)))
