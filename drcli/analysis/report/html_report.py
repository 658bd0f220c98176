"""Writes the report of an analysis as one HTML file."""

import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from drcli.analysis.analysis import Analysis
from drcli.analysis.findings.reward_rate import reward_function_time
from drcli.analysis.report.document import html_document
from drcli.analysis.report.driving_sections import (
    action_section,
    ends_section,
    evaluation_section,
    horizon_section,
    limit_section,
    reward_rate_section,
    steering_section,
)
from drcli.analysis.report.graphs import Picture, Section, picture_section
from drcli.analysis.report.lap_choice import LapChoice, choose_laps
from drcli.analysis.report.map_section import map_data, map_section
from drcli.analysis.report.markup import Content, Html, coloured_difference, element, table
from drcli.analysis.report.summary_sections import (
    lap_section,
    learner_section,
    overview,
    reward_section,
    verdict_section,
)
from drcli.analysis.run import Run
from drcli.base.files import rewrite
from drcli.model.files.action_space import ActionSpace

# The settings of a training, and what differs from its parent.


_TABLES = ("hyperparameters.json", "model_metadata.json", "settings")


def settings_section(run: Run) -> Section | None:
    content: list[Content] = [*_differences(run)]
    if run.hyperparameters:
        rows = [[name, _value(value)] for name, value in sorted(run.hyperparameters.items())]
        content.append(table("Hyperparameters", ["name", "value"], rows, texts=2))
    if run.actions is not None:
        content.append(_actions(run.actions))
    for name, text in sorted(run.files.items()):
        if name in ("hyperparameters.json", "model_metadata.json") and _parsed(text):
            continue
        shown = element("pre", element("code", text))
        content.append(element("details", element("summary", name), shown))
    if not content:
        return None
    look = (
        "Look at what changed since the parent model: a change of one thing at a time can be "
        "judged, several at once cannot."
        if run.parent
        else "Look up here what this training was driven with before you compare it with another."
    )
    return Section("settings", "Settings", "Settings", look, tuple(content))


def _differences(run: Run) -> Iterator[Html]:
    if run.parent is None:
        return
    yield element("h3", "Compared with its parent, ", element("code", run.parent))
    if not run.parent_files:
        yield element("p", "The files of that model could not be read, so nothing is compared.")
        return
    rows: list[list[Content]] = []
    for name in _TABLES:
        if name not in run.files or name not in run.parent_files:
            continue
        before, now = _values(run.parent_files[name]), _values(run.files[name])
        rows += [
            [key, before.get(key, "(not set)"), now.get(key, "(not set)")]
            for key in sorted({*before, *now})
            if before.get(key) != now.get(key)
        ]
    if rows:
        yield table("Values that differ", ["name", "parent", "this model"], rows, texts=3)
    changed = [
        name
        for name in sorted({*run.files, *run.parent_files} - {*_TABLES})
        if run.parent_files.get(name, "") != run.files.get(name, "")
    ]
    for name in changed:
        yield element("h3", name)
        before_lines, now_lines = (
            files.get(name, "").splitlines() for files in (run.parent_files, run.files)
        )
        lines = difflib.unified_diff(before_lines, now_lines, n=2, lineterm="")
        yield coloured_difference([*lines][2:])
    if not rows and not changed:
        yield element("p", "All files and settings that could be read are the same.")


def _actions(space: ActionSpace) -> Html:
    if space.low is not None and space.high is not None:
        rows = [
            [name, f"{low:g}", f"{high:g}"]
            for name, low, high in zip(
                ("steering (degrees, left positive)", "speed (m/s)"),
                space.low,
                space.high,
                strict=True,
            )
        ]
        return table("Continuous actions", ["quantity", "low", "high"], rows)
    listed = [
        [str(number), f"{steering:g}", f"{speed:g}"]
        for number, (steering, speed) in enumerate(space.values)
    ]
    found = table(
        "Action space", ["action", "steering (degrees, left positive)", "speed (m/s)"], listed
    )
    return element("details", element("summary", f"{len(listed)} actions"), found)


def _values(text: str) -> dict[str, str]:
    """Of JSON by path, of NAME=VALUE lines by name."""
    parsed = _parsed(text)
    if parsed is not None:
        return dict(_flat(parsed, ""))
    pairs = (line.partition("=") for line in text.splitlines() if "=" in line)
    return {
        name.removeprefix("export ").strip(): value.strip()
        for name, _, value in pairs
        if not name.startswith("#")
    }


def _flat(value: object, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flat(part, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for number, part in enumerate(value):
            yield from _flat(part, f"{path}[{number}]")
    else:
        yield path, _value(value)


def _parsed(text: str) -> dict[str, object] | list[object] | None:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict | list) else None


def _value(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)


def write_html(analysis: Analysis, path: Path, pictures: Sequence[Picture] = ()) -> int:
    """Write the report, and return its size in bytes.

    Raises:
        SettingsError: It cannot be written.
    """
    data = report_page(analysis, pictures).encode("utf-8")
    rewrite(path, data)
    return len(data)


def report_page(analysis: Analysis, pictures: Sequence[Picture] = ()) -> str:
    run = analysis.run
    laps = choose_laps(run.episodes)
    drawn = map_data(run, laps)
    sections = [section for section in _sections(analysis, laps, drawn, pictures) if section]
    title = f"{run.name}: what the car learned"
    origin = element("p", f"{run.origin}, {run.world or 'track not known'}", class_="origin")
    return html_document(title, [origin], overview(run), sections, drawn)


def _sections(
    analysis: Analysis,
    laps: LapChoice,
    drawn: dict[str, Any] | None,
    pictures: Sequence[Picture],
) -> Iterator[Section | None]:
    run, found = analysis.run, analysis.evidence
    yield verdict_section(analysis.verdict, analysis.advice)
    yield reward_section(run)
    yield lap_section(run)
    yield map_section(run, laps) if drawn is not None else None
    yield limit_section(run)
    yield ends_section(found.ends, found.off)
    yield action_section(found.actions)
    yield steering_section(found.balance, found.snaking)
    yield reward_rate_section(run, found.rate)
    yield horizon_section(found.horizon, reward_function_time(run.steps))
    yield learner_section(run)
    yield evaluation_section(run)
    yield picture_section(pictures)
    yield settings_section(run)
