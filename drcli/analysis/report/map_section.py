"""The map with its controls, and tables of laps."""

from typing import TYPE_CHECKING, Any

import numpy as np

from drcli.analysis.report.lap_choice import LapChoice
from drcli.analysis.report.map_data import FIFTHS
from drcli.analysis.report.map_laps import evaluations_on_the_map
from drcli.analysis.report.markup import Content, Html, element, table
from drcli.analysis.report.section import Section
from drcli.analysis.report.words import count, digits, nth, percent, seconds
from drcli.analysis.run import Run

if TYPE_CHECKING:
    import pandas as pd

_PAINTS = {
    "lap": "lap",
    "reward": "reward of a step",
    "driven": "driven speed",
    "speed": "requested speed",
    "steering": "steering",
    "slip": "slip angle",
    "visits": "how often driven",
}
_SPEEDS = {"0.5": "half", "1": "real", "2": "double", "5": "5 times"}
_LISTED = ("episode", "iteration", "read", "progress", "time", "reward", "end")
_ROWS = 5


def map_section(run: Run, laps: LapChoice) -> Section:
    all_laps = len(laps.ids) == len(run.episodes)
    shown = "All laps" if all_laps else f"{len(laps.ids)} of {count(len(run.episodes))} laps"
    steps = "" if laps.every == 1 else f", with every {nth(laps.every)} step of each,"
    chosen = "" if all_laps else ": the best and the worst of the iterations, then others"
    note = f"{shown}{steps} are in this page{chosen}."
    if run.track is None:
        note += " The track is not known here, so its borders are not drawn."
    look = (
        "Look for the place where the worst laps end and compare the speed and steering of the "
        "fastest laps there; where they leave the line that pays most, the reward and the lap "
        "time disagree."
    )
    content: tuple[Content, ...] = (
        _controls(run),
        element("p", note, class_="quiet"),
        element(
            "details",
            element("summary", "Laps that stand out"),
            *_lap_tables(run.episodes),
        ),
    )
    return Section("track", "On the track", "Track map", look, content)


def _controls(run: Run) -> Html:
    groups = {"steps-0": "all steps, whole training"}
    for number, name in enumerate(FIFTHS, start=1):
        groups[f"steps-{number}"] = f"all steps, {name} fifth"
    groups |= {
        "fastest": "fastest laps",
        "worst": "worst laps of the last fifth",
        "both": "fastest and worst laps",
        "iteration": "one iteration",
    }
    for number, stamp in enumerate(evaluations_on_the_map(run)):
        groups[f"evaluation-{number}"] = f"evaluation {stamp}"
    return element(
        "div",
        element(
            "div",
            _select("Show", "what", groups, "both"),
            _select("Colours", "paint", _PAINTS, "lap"),
            element(
                "label",
                element("input", type="checkbox", data_part="ends"),
                "where episodes ended",
                class_="tick",
            ),
            element(
                "label",
                element("span", "Iteration ", element("output", data_part="iteration-number")),
                element("input", type="range", min="0", max="0", step="1", data_part="iteration"),
                class_="wide",
                data_part="iteration-room",
                hidden=True,
            ),
            class_="controls",
        ),
        element(
            "div",
            element(
                "canvas",
                class_="map",
                data_part="canvas",
                tabindex="0",
                role="img",
                aria_label="Map of the track. Space plays and pauses, the left and right arrow "
                "keys move by a step, page up and page down change the iteration, plus and "
                "minus zoom.",
            ),
            element(
                "div",
                element("button", "+", type="button", data_part="in", aria_label="Zoom in"),
                element(
                    "button",
                    "\N{MINUS SIGN}",
                    type="button",
                    data_part="out",
                    aria_label="Zoom out",
                ),
                class_="zoom",
            ),
            class_="canvas-room",
        ),
        element(
            "div",
            element(
                "span",
                element("span", data_part="low"),
                " ",
                element("canvas", width="144", height="10", data_part="bar", aria_hidden="true"),
                " ",
                element("span", data_part="high"),
                class_="scale",
                data_part="scale",
            ),
            element("span", class_="scale", data_part="keys"),
            class_="scale",
        ),
        element(
            "div",
            element("button", "Play", type="button", data_part="play"),
            element(
                "label",
                "Time",
                element("input", type="range", min="0", max="1", step="0.02", data_part="time"),
                class_="wide",
            ),
            _select("Speed", "speed", _SPEEDS, "1"),
            class_="controls",
            data_part="player",
            hidden=True,
        ),
        element("p", class_="readout", data_part="readout"),
        element(
            "div",
            table("Laps on the map", _LISTED, [], texts=1),
            class_="laps",
            data_part="laps-room",
            hidden=True,
        ),
        id="map",
    )


def _select(label: str, part: str, options: dict[str, str], chosen: str) -> Html:
    found = [
        element("option", text, value=value, selected=value == chosen)
        for value, text in options.items()
    ]
    return element("label", label, element("select", *found, data_part=part))


def _lap_tables(episodes: "pd.DataFrame") -> list[Html]:
    full = episodes["complete"].astype(bool)
    from_start = full & (episodes["start_at"] <= 1)
    kinds: list[tuple[str, Any, str, bool]] = [
        ("Fastest clean laps", full, "time", True),
        ("Fastest clean laps from the start line", from_start, "time", True),
        ("Clean laps with the highest reward", full, "reward", False),
        ("Episodes with the highest reward", np.ones(len(episodes), bool), "reward", False),
        ("Furthest of those that did not finish", ~full, "progress", False),
    ]
    tables = []
    for title, mask, column, ascending in kinds:
        found = episodes[mask].sort_values(column, ascending=ascending, kind="stable")[:_ROWS]
        if len(found):
            tables.append(
                table(title, _HEAD, [_row(episode) for _, episode in found.iterrows()], texts=0)
            )
    return tables


_HEAD = (
    "iteration",
    "episode",
    "progress",
    "time (s)",
    "steps",
    "start at",
    "mean speed (m/s)",
    "reward",
    "reward per step",
    "end",
)


def _row(episode: Any) -> list[Content]:
    steps = max(float(episode["steps"]) - 1, 1.0)
    return [
        str(int(episode["iteration"])),
        str(int(episode["episode"])),
        percent(episode["progress"]),
        seconds(episode["time"]),
        count(episode["steps"]),
        count(episode["start_at"]),
        digits(episode["speed"]),
        digits(episode["reward"]),
        digits(episode["reward"] / steps),
        str(episode["status"]).replace("_", " "),
    ]
