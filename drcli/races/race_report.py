"""What is shown of a race, as frozen records."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from drcli.base.report import Col, Rows, Styled, View, bold, dim, table
from drcli.config.value_types import USUAL_CAR
from drcli.races import race_words as words
from drcli.races.race_records import RaceRules
from drcli.races.race_settings import shown_settings
from drcli.races.race_words import NONE
from drcli.tracks.track_limit import limit_of, limit_text

RaceState = Literal["scheduled", "open", "closed", "finished"]
"""Before opening, taking submissions, taking no more, and completely driven."""

SubmissionState = Literal["queued", "running", "done", "failed", "over the limit"]


@dataclass(frozen=True)
class LeaderboardRow:
    """A submission on the leaderboard. Times are simulated seconds, penalties included."""

    rank: Annotated[int | None, "From 1; None if not qualified.", Col("rank", none="not qualified")]
    racer: Annotated[str, "Who submitted it.", Col("racer")]
    model: Annotated[str, "Prefix of the model.", Col("model")]
    checkpoint: Annotated[str, "Name of the checkpoint."]
    submission: Annotated[str, "Id of the submission.", Col("submission")]
    score_s: Annotated[
        float | None, "The time that decides; None if not qualified, and in pairs."
    ] = None
    gap_s: Annotated[
        float | None, "Behind the first; None without a time.", Col("gap", of=lambda row: row.gap())
    ] = None
    best_lap_s: Annotated[float | None, "Fastest complete lap, or None."] = None
    best_average_s: Annotated[
        float | None, "Best average of consecutive complete laps, or None."
    ] = None
    total_s: Annotated[float | None, "All laps together; None if one was not completed."] = None
    complete_laps: Annotated[int, "With or without resets."] = 0
    laps: Annotated[int, "Laps driven."] = 0
    off_track: Annotated[int, "How often the car left the track.", Col("off track")] = 0
    crashes: Annotated[int, "How often it crashed.", Col("crashes")] = 0
    resets: Annotated[int, "How often it was put back on the track."] = 0
    video: Annotated[str, "Key of the video, or empty."] = ""
    clean_laps: Annotated[int, "Completed without reset and penalty."] = 0
    score_text: Annotated[
        str,
        "The time that decides with penalties and resets, for people.",
        Col("time", side="right"),
    ] = ""
    best_lap_text: Annotated[str, "The best lap likewise.", Col("best lap", side="right")] = ""
    best_average_text: Annotated[
        str, "The best average likewise.", Col("average", side="right")
    ] = ""
    total_text: Annotated[str, "The total likewise.", Col("total", side="right")] = ""
    laps_text: Annotated[
        str, "Clean laps, and the others with their resets.", Col("laps", side="right")
    ] = ""
    points: Annotated[float | None, "Of its pairs; None in other races.", Col("points", "{:g}")] = (
        None
    )
    wins: Annotated[int, "Pairs won.", Col("won")] = 0
    draws: Annotated[int, "Pairs that nobody won.", Col("drawn")] = 0
    losses: Annotated[int, "Pairs lost.", Col("lost")] = 0
    round: Annotated[int | None, "Last round reached in a bracket; None elsewhere."] = None

    def gap(self) -> str:
        if self.gap_s is None:
            return NONE
        return "" if self.rank == 1 else f"+{self.gap_s:.3f} s"


@dataclass(frozen=True)
class SubmissionEntry:
    """A submission, whatever became of it."""

    submission: Annotated[str, "Id of the submission."]
    racer: Annotated[str, "Who submitted it."]
    model: Annotated[str, "Prefix of the model."]
    checkpoint: Annotated[str, "Name of the checkpoint."]
    submitted_at: Annotated[str, "When it came, ISO 8601."]
    state: Annotated[
        SubmissionState,
        "queued, running, done, failed, or over the limit of submissions that count.",
    ]
    place: Annotated[int | None, "In the queue, from 1; None if it does not wait."] = None
    message: Annotated[str, "Why it failed."] = ""
    remedy: Annotated[str, "What to do."] = ""
    notes: Annotated[list[str], "About its laps."] = field(default_factory=list)
    lap_s: Annotated[list[float], "Times of its laps, simulated seconds."] = field(
        default_factory=list
    )
    lap_status: Annotated[list[str], "How each lap ended."] = field(default_factory=list)
    lap_text: Annotated[list[str], "With penalties and resets, for people."] = field(
        default_factory=list
    )
    simtrace: Annotated[str, "Key of its trace."] = ""
    metrics: Annotated[str, "Key of its metrics."] = ""
    video: Annotated[str, "Key of its video, or empty."] = ""

    def line(self, on_board: Collection[str], most: int) -> Iterator[object]:
        """What became of it, unless the leaderboard says that."""
        name = f"{self.racer}, {self.model} ({self.submission})"
        if self.state in ("queued", "running"):
            place = f" at place {self.place}" if self.place is not None else ""
            yield f"{name}: {self.state}{place}"
        elif self.state == "failed":
            yield Styled(f"{name}: failed. {self.message}", "red")
            yield [self.remedy and dim(f"Try: {self.remedy}")]
        elif self.state == "over the limit":
            yield f"{name}: does not count, more than {most} of this racer"
        elif self.submission not in on_board:
            yield f"{name}: driven; a better one of this racer is on the leaderboard"


@dataclass(frozen=True)
class PairEntry:
    """A pair of a race in pairs."""

    round: Annotated[int, "From 1.", Col("round")]
    first: Annotated[str, "Id of the submission on the one side; empty if unknown yet."]
    second: Annotated[str, "Id of the other; empty if unknown yet, or the first goes on alone."]
    first_racer: Annotated[str, "Who submitted the first.", Col("first", lambda text: text or NONE)]
    second_racer: Annotated[
        str, "Who submitted the second.", Col("second", lambda text: text or NONE)
    ]
    state: Annotated[
        Literal["waiting", "queued", "running", "done", "failed", "alone"],
        "waiting for earlier pairs, queued, running, done, failed, or alone: goes on "
        "without racing.",
        Col("result", of=lambda pair: pair.result(), side="left"),
    ]
    winner: Annotated[str, "Id of the winner; empty for nobody."] = ""
    first_laps: Annotated[int, "Completed by the first."] = 0
    second_laps: Annotated[int, "Completed by the second."] = 0
    first_s: Annotated[
        float | None, "Time of these laps of the first, simulated seconds, or None."
    ] = None
    second_s: Annotated[float | None, "The same of the second."] = None
    first_text: Annotated[
        str, "Laps and time of the first with resets and penalties, for people."
    ] = ""
    second_text: Annotated[str, "The same of the second."] = ""
    message: Annotated[str, "Why it failed."] = ""
    remedy: Annotated[str, "What to do."] = ""
    videos: Annotated[list[str], "Keys, one from each car."] = field(default_factory=list)

    def result(self) -> str:
        if self.state == "failed":
            return f"failed: {self.message}"
        if self.state != "done":
            states = {"waiting": "waits for earlier pairs", "alone": "goes on without racing"}
            return states.get(self.state, self.state)
        first, second = self.first_text, self.second_text
        if not self.winner:
            return f"nobody wins: {first}, {second}"
        if self.winner == self.first:
            return f"{self.first_racer} wins: {first} against {second}"
        return f"{self.second_racer} wins: {second} against {first}"


@dataclass(frozen=True)
class RaceReport:
    """A race: rules, leaderboard, and what is still to be driven."""

    bucket: Annotated[str, "Where it is."]
    race: Annotated[str, "Its id."]
    state: Annotated[
        RaceState, "scheduled, open, closed, or finished: closed, and everything was driven."
    ]
    rules: Annotated[RaceRules, "Of the race."]
    leaderboard: Annotated[
        list[LeaderboardRow], "The best submission of each racer, the best first."
    ]
    queue: Annotated[
        list[str],
        "Ids to be driven, in order: of submissions, or of both in a pair with a plus sign.",
    ]
    running: Annotated[str, "What is driven now, in the same words, or empty."]
    runner: Annotated[str, "The process that drives the queue now, or empty."]
    submissions: Annotated[list[SubmissionEntry], "In the order in which they came."]
    pairs: Annotated[list[PairEntry], "Of a race in pairs, round by round."]
    winner: Annotated[str | None, "First racer of a finished race; None before."]
    damaged: Annotated[list[str], "Sentences about unreadable objects."]
    limit: Annotated[str, "How far its best lap is from the limit of the track, or empty."] = ""

    def place(self) -> str:
        way = ", opposite direction" if self.rules.reverse else ""
        return f"{self.rules.world}{way}, {words.kind(self.rules)}"

    def standing(self) -> str:
        left = len(self.queue)
        runs = f"{left} run{'s' * (left != 1)} {'wait' if left != 1 else 'waits'}"
        if self.winner is not None:
            return f"Winner: {self.winner}."
        texts = {
            "scheduled": "Not open yet.",
            "open": "Open for submissions.",
            "closed": "Closed for submissions.",
            "finished": "Finished; nobody is ranked.",
        }
        said = texts[self.state]
        if self.running:
            racers = {each.submission: each.racer for each in self.submissions}
            drive = [racers.get(each, each) for each in self.running.split("+")]
            said += f" {' against '.join(drive)} {'drive' if drive[1:] else 'drives'} now."
        if left:
            said += f" {runs} in the queue" + ("." if self.runner else ", and nobody drives it.")
        return said

    def board(self) -> Rows:
        times = ("score_text", "gap_s", "best_lap_text", "best_average_text", "total_text")
        points = ("points", "wins", "draws", "losses", "best_lap_text")
        decides = points if self.rules.in_pairs else times
        order = (
            "rank",
            "racer",
            "model",
            *decides,
            "laps_text",
            "off_track",
            "crashes",
            "submission",
        )
        average = f"average of {self.rules.average_laps}"
        return table(self.leaderboard, *order, best_average_text=average)

    def view(self) -> View:
        rules = self.rules
        yield bold(f"{rules.name} ({self.race})")
        yield f"{self.place()}. {words.decides(rules)} {words.penalties(rules)}"
        different = words.conditions(rules)
        yield different and dim(f"Settings: {different}")
        yield bold(self.standing())
        yield self.board()
        yield self.limit and f"The best lap, {self.limit}."
        yield table(self.pairs)
        on_board = {row.submission for row in self.leaderboard}
        for entry in self.submissions:
            yield from entry.line(on_board, rules.max_submissions)
        yield from map(dim, dict.fromkeys(note for each in self.submissions for note in each.notes))
        video = next((row.video for row in self.leaderboard if row.video), "")
        yield video and dim(f"Videos: s3://{self.bucket}/{video.rpartition('/')[0]}/")


@dataclass(frozen=True)
class RaceEntry:
    """A race in the list."""

    race: Annotated[str, "Its id.", Col("race")]
    name: Annotated[str, "What it is called."]
    state: Annotated[
        RaceState,
        "scheduled, open, closed or finished.",
        Col(
            "state", of=lambda race: race.state + (" (running)" if race.runner else ""), side="left"
        ),
    ]
    world: Annotated[str, "The track.", Col("track")]
    race_type: Annotated[str, "As DR_RACE_TYPE.", Col("type")]
    submissions: Annotated[int, "How many there are.", Col("submissions")]
    queued: Annotated[int, "Runs that are still to be driven.", Col("waiting")]
    leader: Annotated[str | None, "First racer, or None.", Col("leader", none="")]
    leader_s: Annotated[float | None, "The time that decided, or None."]
    runner: Annotated[str, "The process that drives its queue now, or empty."]
    created_at: Annotated[str, "When it was made, ISO 8601."]
    leader_text: Annotated[
        str, "The same with penalties and resets, for people.", Col("time", side="right")
    ] = ""


@dataclass(frozen=True)
class RaceList:
    """The races of a bucket."""

    bucket: Annotated[str, "Name of the bucket."]
    races: Annotated[list[RaceEntry], "The newest first."]
    damaged: Annotated[list[str], "Sentences about races that cannot be read."] = field(
        default_factory=list
    )

    def view(self) -> View:
        none = f"s3://{self.bucket} has no races. Make one with `dr-race create NAME`."
        return [table(self.races) if self.races else none]


# Compares a race's best lap with the track's limit.


def with_limit(report: RaceReport, tracks_folder: Path, directory: Path) -> RaceReport:
    rules = report.rules
    own_car = any(name.startswith("DR_CAR_") for name in shown_settings(rules))
    laps = [row.best_lap_s for row in report.leaderboard if row.best_lap_s is not None]
    if own_car or not laps:
        return report
    car = rules.settings.get("DR_SIM_CAR", USUAL_CAR)
    stored = limit_of(rules.world, tracks_folder, directory, reverse=rules.reverse, car=car)
    return replace(report, limit=limit_text(min(laps), stored))
