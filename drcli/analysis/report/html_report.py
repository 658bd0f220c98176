"""Writes the report of an analysis as one HTML file."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from drcli.analysis.analysis import Analysis
from drcli.analysis.findings.reward_function_time import reward_function_time
from drcli.analysis.report.document import html_document
from drcli.analysis.report.driving_sections import (
    action_section,
    ends_section,
    horizon_section,
    steering_section,
)
from drcli.analysis.report.evaluation_section import evaluation_section
from drcli.analysis.report.lap_choice import LapChoice, choose_laps
from drcli.analysis.report.limit_section import limit_section
from drcli.analysis.report.map_data import map_data
from drcli.analysis.report.map_section import map_section
from drcli.analysis.report.markup import element
from drcli.analysis.report.picture_section import Picture, picture_section
from drcli.analysis.report.progress_sections import lap_section, learner_section, reward_section
from drcli.analysis.report.reward_rate_section import reward_rate_section
from drcli.analysis.report.section import Section
from drcli.analysis.report.settings_section import settings_section
from drcli.analysis.report.summary_sections import overview, verdict_section
from drcli.base.atomic_file import rewrite


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
