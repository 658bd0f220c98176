"""What is shown of a race, as frozen records."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from drcli.config.value_types import USUAL_CAR
from drcli.races.race_records import RaceRules
from drcli.races.race_settings import shown_settings
from drcli.tracks.track_limit import limit_of, limit_text

RaceState = Literal["scheduled", "open", "closed", "finished"]
"""Before opening, taking submissions, taking no more, and completely driven."""

SubmissionState = Literal["queued", "running", "done", "failed", "over the limit"]


@dataclass(frozen=True)
class LeaderboardRow:
    """A submission on the leaderboard. Times are simulated seconds, penalties included.

    Attributes:
        rank: From 1; None if not qualified.
        racer: Who submitted it.
        model: Prefix of the model.
        checkpoint: Name of the checkpoint.
        submission: Id of the submission.
        score_s: The time that decides; None if not qualified, and in pairs.
        gap_s: Behind the first; None without a time.
        best_lap_s: Fastest complete lap, or None.
        best_average_s: Best average of consecutive complete laps, or None.
        total_s: All laps together; None if one was not completed.
        complete_laps: With or without resets.
        laps: Laps driven.
        off_track: How often the car left the track.
        crashes: How often it crashed.
        resets: How often it was put back on the track.
        video: Key of the video, or empty.
        clean_laps: Completed without reset and penalty.
        score_text: The time that decides with penalties and resets, for people.
        best_lap_text: The best lap likewise.
        best_average_text: The best average likewise.
        total_text: The total likewise.
        laps_text: Clean laps, and the others with their resets.
        points: Of its pairs; None in other races.
        wins: Pairs won.
        draws: Pairs that nobody won.
        losses: Pairs lost.
        round: Last round reached in a bracket; None elsewhere.
    """

    rank: int | None
    racer: str
    model: str
    checkpoint: str
    submission: str
    score_s: float | None = None
    gap_s: float | None = None
    best_lap_s: float | None = None
    best_average_s: float | None = None
    total_s: float | None = None
    complete_laps: int = 0
    laps: int = 0
    off_track: int = 0
    crashes: int = 0
    resets: int = 0
    video: str = ""
    clean_laps: int = 0
    score_text: str = ""
    best_lap_text: str = ""
    best_average_text: str = ""
    total_text: str = ""
    laps_text: str = ""
    points: float | None = None
    wins: int = 0
    draws: int = 0
    losses: int = 0
    round: int | None = None


@dataclass(frozen=True)
class SubmissionEntry:
    """A submission, whatever became of it.

    Attributes:
        submission: Id of the submission.
        racer: Who submitted it.
        model: Prefix of the model.
        checkpoint: Name of the checkpoint.
        submitted_at: When it came, ISO 8601.
        state: queued, running, done, failed, or over the limit of submissions that count.
        place: In the queue, from 1; None if it does not wait.
        message: Why it failed.
        remedy: What to do.
        notes: About its laps.
        lap_s: Times of its laps, simulated seconds.
        lap_status: How each lap ended.
        lap_text: With penalties and resets, for people.
        simtrace: Key of its trace.
        metrics: Key of its metrics.
        video: Key of its video, or empty.
    """

    submission: str
    racer: str
    model: str
    checkpoint: str
    submitted_at: str
    state: SubmissionState
    place: int | None = None
    message: str = ""
    remedy: str = ""
    notes: list[str] = field(default_factory=list)
    lap_s: list[float] = field(default_factory=list)
    lap_status: list[str] = field(default_factory=list)
    lap_text: list[str] = field(default_factory=list)
    simtrace: str = ""
    metrics: str = ""
    video: str = ""


@dataclass(frozen=True)
class PairEntry:
    """A pair of a race in pairs.

    Attributes:
        round: From 1.
        first: Id of the submission on the one side; empty if unknown yet.
        second: Id of the other; empty if unknown yet, or the first goes on alone.
        first_racer: Who submitted the first.
        second_racer: Who submitted the second.
        state: waiting for earlier pairs, queued, running, done, failed, or alone: goes on without
            racing.
        winner: Id of the winner; empty for nobody.
        first_laps: Completed by the first.
        second_laps: Completed by the second.
        first_s: Time of these laps of the first, simulated seconds, or None.
        second_s: The same of the second.
        first_text: Laps and time of the first with resets and penalties, for people.
        second_text: The same of the second.
        message: Why it failed.
        remedy: What to do.
        videos: Keys, one from each car.
    """

    round: int
    first: str
    second: str
    first_racer: str
    second_racer: str
    state: Literal["waiting", "queued", "running", "done", "failed", "alone"]
    winner: str = ""
    first_laps: int = 0
    second_laps: int = 0
    first_s: float | None = None
    second_s: float | None = None
    first_text: str = ""
    second_text: str = ""
    message: str = ""
    remedy: str = ""
    videos: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class RaceReport:
    """A race: rules, leaderboard, and what is still to be driven.

    Attributes:
        bucket: Where it is.
        race: Its id.
        state: scheduled, open, closed, or finished: closed, and everything was driven.
        rules: Of the race.
        leaderboard: The best submission of each racer, the best first.
        queue: Ids to be driven, in order: of submissions, or of both in a pair with a plus sign.
        running: What is driven now, in the same words, or empty.
        runner: The process that drives the queue now, or empty.
        submissions: In the order in which they came.
        pairs: Of a race in pairs, round by round.
        winner: First racer of a finished race; None before.
        damaged: Sentences about unreadable objects.
        limit: How far its best lap is from the limit of the track, or empty.
    """

    bucket: str
    race: str
    state: RaceState
    rules: RaceRules
    leaderboard: list[LeaderboardRow]
    queue: list[str]
    running: str
    runner: str
    submissions: list[SubmissionEntry]
    pairs: list[PairEntry]
    winner: str | None
    damaged: list[str]
    limit: str = ""


@dataclass(frozen=True)
class RaceEntry:
    """A race in the list.

    Attributes:
        race: Its id.
        name: What it is called.
        state: scheduled, open, closed or finished.
        world: The track.
        race_type: As DR_RACE_TYPE.
        submissions: How many there are.
        queued: Runs that are still to be driven.
        leader: First racer, or None.
        leader_s: The time that decided, or None.
        leader_text: The same with penalties and resets, for people.
        runner: The process that drives its queue now, or empty.
        created_at: When it was made, ISO 8601.
    """

    race: str
    name: str
    state: RaceState
    world: str
    race_type: str
    submissions: int
    queued: int
    leader: str | None
    leader_s: float | None
    runner: str
    created_at: str
    leader_text: str = ""


@dataclass(frozen=True)
class RaceList:
    """The races of a bucket.

    Attributes:
        bucket: Name of the bucket.
        races: The newest first.
        damaged: Sentences about races that cannot be read.
    """

    bucket: str
    races: list[RaceEntry]
    damaged: list[str] = field(default_factory=list)


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
