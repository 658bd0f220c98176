"""Writes a race as CSV and HTML."""

import base64
import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import Annotated

from drcli.base.files import rewrite
from drcli.base.report import Rows, View, counted, table
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.races import race_words as words
from drcli.races.race_report import LeaderboardRow, RaceReport
from drcli.races.standings import date_text

# A race as one HTML file without scripts and network.


_POLICY = "default-src 'none'; style-src 'unsafe-inline'; media-src data:; img-src data:"
"""Against what names may contain."""

_STYLE = """
:root{color-scheme:light dark;--line:light-dark(#c9ced6,#4a515c);--card:light-dark(#fff,#1b1f26);
--soft:light-dark(#5a6472,#a3adba);--first:light-dark(#8a5b00,#ffc94d)}
*{box-sizing:border-box}
body{font:16px/1.5 system-ui,sans-serif;max-width:75rem;margin:0 auto;padding:1rem;
background:light-dark(#f5f6f8,#12151a);color:light-dark(#1d2229,#e6e9ee);overflow-wrap:anywhere}
h1{font-size:1.6rem;margin:.2rem 0}h2{font-size:1.2rem;margin:1.6rem 0 .4rem}
p{margin:.3rem 0}.soft{color:var(--soft)}.state{font-weight:600}
table{border-collapse:collapse;width:100%;background:var(--card);font-variant-numeric:tabular-nums}
caption{text-align:left;color:var(--soft);padding:.3rem 0}
th,td{padding:.45rem .6rem;border:1px solid var(--line);text-align:right;vertical-align:top}
th{font-weight:600}.name{text-align:left}.first td{font-weight:600}
.first .rank{color:var(--first)}
video{width:100%;max-width:40rem;display:block}
figure{margin:1rem 0}figcaption{font-weight:600}
details{margin:.6rem 0}summary{cursor:pointer;padding:.3rem 0}
@media(max-width:700px){
thead{position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)}
table,caption,tbody,tr,td{display:block;width:100%}tr{border:1px solid var(--line);margin:0 0 .7rem}
td{border:0;display:flex;justify-content:space-between;gap:1rem;padding:.25rem .6rem}
td::before{content:attr(data-label);flex:none;color:var(--soft);font-weight:400;text-align:left}
.name{text-align:right}}
"""


def race_page(report: RaceReport, videos: Mapping[str, bytes]) -> str:
    rules = report.rules
    title = escape(rules.name)
    facts = [words.decides(rules), words.penalties(rules)]
    if rules.closes_at is not None:
        facts.append(f"Closes: {date_text(rules.closes_at)}.")
    different = words.conditions(rules)
    if different:
        facts.append(f"Settings: {different}.")
    board = '<p class="soft">Nobody has driven yet.</p>'
    if report.leaderboard:
        board = _table("Times in minutes:seconds, penalties included.", report.board())
    pairs = ""
    if report.pairs:
        drawn = _table("Complete laps and the time for them.", table(report.pairs))
        pairs = f"<h2>Pairs</h2>{drawn}"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head><body><main>"
        f"<h1>{title}</h1><p>{escape(report.place())}</p>"
        f'<p class="state">{escape(report.standing())}</p>'
        f'<p class="soft">{escape(" ".join(facts))}</p>'
        f"<h2>Leaderboard</h2>{board}"
        f"{pairs}{_laps(report)}{_films(report, videos)}"
        "</main></body></html>\n"
    )


def _table(caption: str, rows: Rows) -> str:
    # With roles, because a table that is laid out as blocks on a phone is no table to a reader.
    names = [escape(name.capitalize()) for name in rows.names]
    kinds = ["rank" if name == "rank" else "name" * (name in rows.left) for name in rows.names]
    head = "".join(
        f'<th scope="col" role="columnheader" class="{kind}">{name}</th>'
        for name, kind in zip(names, kinds, strict=True)
    )
    body = "".join(
        f'<tr role="row" class="{"first" * (cells[0] == "1" and kinds[0] == "rank")}">'
        + "".join(
            f'<td role="cell" class="{kind}" data-label="{name}"><span>{text}</span></td>'
            for name, kind, text in zip(names, kinds, map(escape, map(str, cells)), strict=True)
        )
        + "</tr>"
        for cells in rows.cells
    )
    return (
        f'<table role="table"><caption>{escape(caption)}</caption><thead role="rowgroup">'
        f'<tr role="row">{head}</tr></thead><tbody role="rowgroup">{body}</tbody></table>'
    )


def _laps(report: RaceReport) -> str:
    found = []
    for entry in report.submissions:
        laps = "; ".join(entry.lap_text)
        text = laps or entry.message or entry.state
        notes = "".join(f'<p class="soft">{escape(note)}</p>' for note in entry.notes)
        found.append(
            f"<details><summary>{escape(entry.racer)}, {escape(entry.model)} "
            f'({entry.submission})</summary><p>{escape(text)}</p><p class="soft">Checkpoint '
            f"{escape(entry.checkpoint)}, submitted {entry.submitted_at}.</p>{notes}</details>"
        )
    return f"<h2>Submissions</h2>{''.join(found)}" if found else ""


def _films(report: RaceReport, videos: Mapping[str, bytes]) -> str:
    found = []
    for row in report.leaderboard:
        if not row.video:
            continue
        caption = f"<figcaption>{escape(row.racer)}, {escape(row.model)}</figcaption>"
        if row.video in videos:
            data = base64.b64encode(videos[row.video]).decode()
            label = escape(f"Laps of {row.racer}")
            film = (
                f'<video controls preload="metadata" aria-label="{label}" '
                f'src="data:video/mp4;base64,{data}"></video>'
            )
        else:
            film = f'<p class="soft">s3://{escape(report.bucket)}/{escape(row.video)}</p>'
        found.append(f"<figure>{caption}{film}</figure>")
    return f"<h2>Videos</h2>{''.join(found)}" if found else ""


COLUMNS = tuple(each.name for each in fields(LeaderboardRow))
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class ExportedRace:
    """A race that was written into files."""

    race: Annotated[str, "Its id."]
    csv: Annotated[str | None, "Path of the table, or None."]
    html: Annotated[str | None, "Path of the page, or None."]
    size_bytes: Annotated[int, "Size of the page."] = 0
    videos: Annotated[int, "How many it contains."] = 0

    def view(self) -> View:
        films = f" with {counted(self.videos, 'video')}" if self.videos else ""
        size = f"{self.size_bytes / 1e6:.2f} MB{films}"
        return [self.csv and f"Table: {self.csv}", self.html and f"Page: {self.html} ({size})"]


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
