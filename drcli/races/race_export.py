"""Writes a race as CSV and HTML."""

import csv
import io
from dataclasses import dataclass, fields
from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.races.race_page import race_page
from drcli.races.race_report import LeaderboardRow, RaceReport
from drcli.store.bucket import Bucket, ObjectMissing

COLUMNS = tuple(each.name for each in fields(LeaderboardRow))
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class ExportedRace:
    """A race that was written into files.

    Attributes:
        race: Its id.
        csv: Path of the table, or None.
        html: Path of the page, or None.
        size_bytes: Size of the page.
        videos: How many it contains.
    """

    race: str
    csv: str | None
    html: str | None
    size_bytes: int = 0
    videos: int = 0


def csv_of(report: RaceReport) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for row in report.leaderboard:
        table.writerow([_cell(getattr(row, name)) for name in COLUMNS])
    return text.getvalue()


def videos_of(report: RaceReport, bucket: Bucket) -> dict[str, bytes]:
    found = {}
    for row in report.leaderboard:
        if row.video and row.video not in found:
            try:
                found[row.video] = bucket.get(row.video)
            except ObjectMissing:
                continue
    return found


def export_race(
    report: RaceReport,
    *,
    csv_path: Path | None = None,
    html_path: Path | None = None,
    videos: dict[str, bytes] | None = None,
) -> ExportedRace:
    """Raises SettingsError for a file that cannot be written."""
    page = b""
    if csv_path is not None:
        rewrite(csv_path, csv_of(report).encode())
    if html_path is not None:
        page = race_page(report, videos or {}).encode()
        rewrite(html_path, page)
    return ExportedRace(
        report.race,
        None if csv_path is None else str(csv_path),
        None if html_path is None else str(html_path),
        len(page),
        len(videos or {}) if html_path is not None else 0,
    )


def _cell(value: object) -> object:
    if value is None:
        return ""
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"
    return value
