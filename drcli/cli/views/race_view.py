"""Shows races."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, counted, indented
from drcli.races import race_words as words
from drcli.races.race_words import gap

if TYPE_CHECKING:
    from drcli.races.organise import DeletedRace
    from drcli.races.queue_process import QueueStarted
    from drcli.races.race_export import ExportedRace
    from drcli.races.race_report import RaceList, RaceReport
    from drcli.races.submissions import SubmissionReport


def races(found: "RaceList") -> RenderableType:
    if not found.races:
        return Text(f"s3://{found.bucket} has no races. Make one with `dr-race create NAME`.")
    return Rows(
        ("race", "state", "track", "type", "submissions", "waiting", "leader", "time"),
        [
            (
                race.race,
                race.state + (" (running)" if race.runner else ""),
                race.world,
                race.race_type,
                str(race.submissions),
                str(race.queued),
                race.leader or "",
                race.leader_text if race.leader_s is not None else "",
            )
            for race in found.races
        ],
        left=("race", "state", "track", "type", "leader"),
    )


def race(report: "RaceReport") -> RenderableType:
    rules = report.rules
    different = words.conditions(rules)
    parts: list[RenderableType] = [
        Text(f"{rules.name} ({report.race})", style="bold"),
        Text(f"{words.place(report)}. {words.decides(rules)} {words.penalties(rules)}"),
        *([Text(f"Settings: {different}", style="dim")] if different else []),
        Text(words.standing(report), style="bold"),
    ]
    if report.leaderboard:
        parts.append(_pair_board(report) if rules.in_pairs else _board(report))
    if report.limit:
        parts.append(Text(f"The best lap, {report.limit}."))
    if report.pairs:
        rows = [
            (str(pair.round), pair.first_racer, pair.second_racer, words.pair_result(pair))
            for pair in report.pairs
        ]
        left = ("first", "second", "result")
        parts.append(Rows(("round", "first", "second", "result"), rows, left=left))
    parts += _others(report)
    return Group(*parts)


def _board(report: "RaceReport") -> Rows:
    return Rows(
        (
            "rank",
            "racer",
            "model",
            "time",
            "gap",
            "best lap",
            f"average of {report.rules.average_laps}",
            "total",
            "laps",
            "off track",
            "crashes",
            "submission",
        ),
        [
            (
                "" if row.rank is None else str(row.rank),
                row.racer,
                row.model,
                "not qualified" if row.rank is None else row.score_text,
                gap(row),
                row.best_lap_text,
                row.best_average_text,
                row.total_text,
                row.laps_text,
                str(row.off_track),
                str(row.crashes),
                row.submission,
            )
            for row in report.leaderboard
        ],
        left=("racer", "model", "submission"),
    )


def _pair_board(report: "RaceReport") -> Rows:
    return Rows(
        (
            "rank",
            "racer",
            "model",
            "points",
            "won",
            "drawn",
            "lost",
            "best lap",
            "laps",
            "off track",
            "crashes",
            "submission",
        ),
        [
            (
                str(row.rank),
                row.racer,
                row.model,
                f"{row.points or 0:g}",
                str(row.wins),
                str(row.draws),
                str(row.losses),
                row.best_lap_text,
                row.laps_text,
                str(row.off_track),
                str(row.crashes),
                row.submission,
            )
            for row in report.leaderboard
        ],
        left=("racer", "model", "submission"),
    )


def _others(report: "RaceReport") -> Iterable[RenderableType]:
    on_board = {row.submission for row in report.leaderboard}
    videos = [row.video for row in report.leaderboard if row.video]
    for entry in report.submissions:
        name = f"{entry.racer}, {entry.model} ({entry.submission})"
        if entry.state in ("queued", "running"):
            place = f" at place {entry.place}" if entry.place is not None else ""
            yield Text(f"{name}: {entry.state}{place}")
        elif entry.state == "failed":
            yield Text(f"{name}: failed. {entry.message}", style="red")
            if entry.remedy:
                yield indented(Text(f"Try: {entry.remedy}", style="dim"))
        elif entry.state == "over the limit":
            most = report.rules.max_submissions
            yield Text(f"{name}: does not count, more than {most} of this racer")
        elif entry.submission not in on_board:
            yield Text(f"{name}: driven; a better one of this racer is on the leaderboard")
    notes = dict.fromkeys(note for entry in report.submissions for note in entry.notes)
    yield from (Text(note, style="dim") for note in notes)
    if videos:
        yield Text(f"Videos: s3://{report.bucket}/{videos[0].rpartition('/')[0]}/", style="dim")


def taken(report: "SubmissionReport") -> RenderableType:
    number = report.checkpoint.partition("_")[0]
    left = "" if report.left is None else f" {report.racer} has {report.left} left."
    driven = "is driven now" if report.queue else "waits for `dr-race run`"
    return Text(
        f"Submitted checkpoint {number} of {report.model} for {report.racer} as "
        f"{report.submission}; {counted(report.waiting, 'run')} to drive, the queue {driven}.{left}"
    )


def started(report: "QueueStarted") -> RenderableType:
    return Text(f"Driving the queue of {report.race} (process {report.pid}). Log: {report.log}")


def exported(report: "ExportedRace") -> RenderableType:
    films = f" with {counted(report.videos, 'video')}" if report.videos else ""
    lines = [
        *([f"Table: {report.csv}"] if report.csv else []),
        *(
            [f"Page: {report.html} ({report.size_bytes / 1e6:.2f} MB{films})"]
            if report.html
            else []
        ),
    ]
    return Text("\n".join(lines))


def deleted(report: "DeletedRace") -> RenderableType:
    verb = "Would delete" if report.dry_run else "Deleted"
    size = f"{counted(report.objects, 'object')}, {report.size_bytes / 1e6:.1f} MB"
    return Text(f"{verb} race {report.race} of s3://{report.bucket}: {size}.")
