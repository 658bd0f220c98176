"""Shows laps from fresh starts."""

import math
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, fitted

if TYPE_CHECKING:
    from drcli.runs.laps_report import EndPlace, LapsReport

MOST_BARS = 12
BAR = 40
_BESIDE = 32
_WIDTHS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


@fitted
def laps(columns: int, report: "LapsReport") -> RenderableType:
    reports = [report] if report.against is None else [report, report.against]
    times_s = [lap.lap_s for each in reports for lap in each.laps if lap.clean]
    parts: list[RenderableType] = []
    for each in reports:
        if len(reports) > 1:
            parts.append(_bold(each.name))
        parts.append(_histogram(each, _edges(times_s), min(BAR, columns - _BESIDE)))
        if each.ends:
            parts.append(_ends(each.ends))
    parts += [_bold(_summary(each)) for each in reports]
    parts += [Text(f"The best lap, {each.limit}.") for each in reports if each.limit]
    if report.comparison is not None:
        parts.append(_bold(report.comparison.verdict))
    return Group(*parts)


def _bold(text: str) -> Text:
    return Text(text, style="bold")


def _edges(times_s: Sequence[float]) -> list[float]:
    if not times_s:
        return []
    low, high = min(times_s), max(times_s)
    width = next((w for w in _WIDTHS_S if high - low < (MOST_BARS - 1) * w), _WIDTHS_S[-1])
    first, last = math.floor(low / width + 1e-9), math.floor(high / width + 1e-9)
    return [place * width for place in range(first, last + 2)]


def _histogram(report: "LapsReport", edges: Sequence[float], bar: int) -> Rows:
    times_s = [lap.lap_s for lap in report.laps if lap.clean]
    counts = [
        (f"{low:.1f} to {high:.1f} s", sum(low <= time_s + 1e-9 < high for time_s in times_s))
        for low, high in pairwise(edges)
    ]
    others = Counter(lap.status.lower() for lap in report.laps if not lap.clean)
    counts += others.most_common()
    most = max(count for _, count in counts)
    cells = [
        (name, str(count), "█" * math.ceil(max(bar, 1) * count / most)) for name, count in counts
    ]
    return Rows(("lap time", "laps", ""), cells, left=("lap time", ""))


def _ends(places: Sequence["EndPlace"]) -> Rows:
    return Rows(
        ("ended near", "of the lap", "laps", "how"),
        [
            (
                _span(place.first_waypoint, place.last_waypoint, "waypoint", "waypoints"),
                _span(round(place.from_percent), round(place.to_percent), "", "", " %"),
                str(place.laps),
                _how(place.statuses),
            )
            for place in places
        ],
        left=("ended near", "of the lap", "how"),
    )


def _how(statuses: dict[str, int]) -> str:
    if len(statuses) == 1:
        return next(iter(statuses)).lower()
    return ", ".join(f"{count} {status.lower()}" for status, count in statuses.items())


def _span(first: int, last: int, one: str, more: str, unit: str = "") -> str:
    """Such as "waypoint 7" or "7 to 9 %"."""
    words = f"{one} {first}" if first == last else f"{more} {first} to {last}"
    return words.strip() + unit


def _summary(report: "LapsReport") -> str:
    low, high = (round(100.0 * share) for share in report.clean_interval)
    laps = "lap" if report.driven == 1 else "laps"
    words = (
        f"{report.clean} of {report.driven} {laps} clean ({low} to {high} % with 95 % confidence)"
    )
    if report.clean == 1:
        words += f", {report.fastest_s:.2f} s"
    elif report.clean:
        words += (
            f", median {report.median_s:.2f} s, 90 % within {report.p90_s:.2f} s, "
            f"slowest {report.slowest_s:.2f} s, best {report.fastest_s:.2f} s"
        )
    driver = report.name if report.file is not None else f"checkpoint {report.name}"
    engine = "" if report.runtime == "torch" else f" with --runtime {report.runtime}"
    return f"{words}; {driver}{engine} on {report.world}, seed {report.seed}."
