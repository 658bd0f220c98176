"""The runs of a race that count. Pure functions."""

from dataclasses import dataclass
from datetime import UTC, datetime

from drcli.exchange.race_submission import DrivenCar, RaceResult
from drcli.races import race_words as words
from drcli.races.lap_ranking import LapFigures, same_racer
from drcli.races.race_report import LeaderboardRow, SubmissionState
from drcli.races.stored_race import StoredRace, submission_id


@dataclass(frozen=True)
class Runner:
    """Empty for nobody."""

    session: str = ""
    owner: str = ""


NOBODY = Runner()


def moment(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="seconds")


def counted(stored: StoredRace) -> list[str]:
    """In queue order; the first ones if a racer has too many, as sent at the same time."""
    limit = stored.rules.max_submissions
    given: dict[str, int] = {}
    found = []
    for name, submission in sorted(stored.submissions.items()):
        racer = same_racer(submission.racer)
        given[racer] = given.get(racer, 0) + 1
        if not limit or given[racer] <= limit:
            found.append(name)
    return sorted(found, key=lambda name: (stored.place(name), name))


def run_state(result: RaceResult | None, runner: Runner) -> SubmissionState:
    if result is None:
        return "queued"
    if result.state == "running":
        return "running" if runner.session and result.session == runner.session else "queued"
    return "done" if result.state == "done" else "failed"


def ids_of(run: tuple[str, ...]) -> str:
    return "+".join(map(submission_id, run))


def cars_of(stored: StoredRace) -> dict[str, list[DrivenCar]]:
    found: dict[str, list[DrivenCar]] = {name: [] for name in counted(stored)}
    for name in sorted(stored.results):
        names = name.split("_")
        result = stored.result(*names)
        if result is None or result.state != "done" or not all(each in found for each in names):
            continue
        for car in result.cars:
            if car.submission in names:
                found[car.submission].append(car)
    return found


def row_of(stored: StoredRace, name: str, rank: int | None, figures: LapFigures) -> LeaderboardRow:
    submission = stored.submissions[name]
    return LeaderboardRow(
        rank=rank,
        racer=submission.racer,
        model=submission.model,
        checkpoint=submission.checkpoint,
        submission=submission_id(name),
        best_lap_s=figures.best_lap_s,
        best_average_s=figures.best_average_s,
        total_s=figures.total_s,
        complete_laps=figures.complete,
        laps=figures.driven,
        off_track=figures.off_track,
        crashes=figures.crashes,
        resets=figures.resets,
        clean_laps=figures.clean,
        best_lap_text=words.time_of(figures.best),
        best_average_text=words.time_of(figures.average, len(figures.average)),
        total_text=words.NONE,
        laps_text=words.laps_of(figures),
    )
