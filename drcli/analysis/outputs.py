"""Writes an analysis as HTML report and pictures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.analysis.analysis import Analysis, AnalysisReport
from drcli.analysis.compare_runs import Comparison, compare_runs
from drcli.analysis.report.compare_report import write_comparison
from drcli.analysis.report.html_report import write_html
from drcli.analysis.stills import write_pngs
from drcli.base.errors import SettingsError
from drcli.base.files import refuse_replacing

if TYPE_CHECKING:
    from drcli.analysis.report.graphs import Picture
    from drcli.analysis.run import Run


def check_targets(html: Path | None, png: Path | None, *, force: bool = False) -> None:
    """Refuse targets that cannot be written, before anything is read.

    Raises:
        SettingsError: A file would be replaced, or the folder of one is missing.
    """
    if html is not None:
        refuse_replacing(html, force=force)
    if png is not None and png.exists() and not png.is_dir():
        raise SettingsError(
            f"{png} is a file, so no pictures can be written into it.",
            remedy="Name a folder, such as --png pictures.",
        )


def write_outputs(
    analysis: Analysis,
    html: Path | None,
    png: Path | None,
    explained: "Sequence[Picture]" = (),
    *,
    force: bool = False,
) -> AnalysisReport:
    """Write the report and the pictures that are asked for.

    Raises:
        SettingsError: One cannot be written.
    """
    pictures: tuple[str, ...] = ()
    if png is not None:
        pictures = tuple(str(path) for path in write_pngs(analysis, png, force=force))
    if html is not None:
        write_html(analysis, html, explained)
    return analysis.report(html=None if html is None else str(html), png=pictures)


def write_comparison_of(runs: "Sequence[Run]", html: Path | None) -> Comparison:
    """Compare trainings, and write the page if it is asked for.

    Raises:
        SettingsError: It cannot be written.
    """
    report = compare_runs(runs)
    if html is None:
        return report

    write_comparison(report, html)
    return replace(report, html=str(html))


def write_report(path: Path, analysis: Analysis) -> AnalysisReport:
    """Write the report of a model to its `report_file`; an older one is replaced.

    Raises:
        SettingsError: It cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    check_targets(path, None, force=True)
    return write_outputs(analysis, path, None)
