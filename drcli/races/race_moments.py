"""What a race drives now, and drove last."""

from dataclasses import dataclass, field

from drcli.exchange.race_submission import RaceResult
from drcli.races import race_words as words
from drcli.races.lap_ranking import figures_of
from drcli.races.race_runs import Runner, run_state
from drcli.races.stored_race import StoredRace, submission_id


@dataclass(frozen=True)
class RunCar:
    """Times are simulated seconds; `clean` laps have no reset or penalty."""

    submission: str
    racer: str
    model: str
    complete: int = 0
    laps: int = 0
    best_lap_s: float | None = None
    total_s: float | None = None
    clean: int = 0
    text: str = ""


@dataclass(frozen=True)
class RaceRun:
    """A submission or pair; `key` is unique, state running, done or failed."""

    key: str
    state: str
    began_at: float
    ended_at: float | None
    cars: list[RunCar] = field(default_factory=list)
    message: str = ""


@dataclass(frozen=True)
class RaceMoments:
    driving: RaceRun | None
    last: RaceRun | None


def moments_of(stored: StoredRace, runner: Runner) -> RaceMoments:
    driving: RaceRun | None = None
    last: RaceRun | None = None
    for name in sorted(stored.results):
        names = name.split("_")
        result = stored.result(*names)
        if result is None or not all(each in stored.submissions for each in names):
            continue
        state = run_state(result, runner)
        if state == "running":
            driving = _run(stored, names, result, state)
        elif state in ("done", "failed") and (
            last is None or (result.ended_at or 0.0) > (last.ended_at or 0.0)
        ):
            last = _run(stored, names, result, state)
    return RaceMoments(driving, last)


def _run(stored: StoredRace, names: list[str], result: RaceResult, state: str) -> RaceRun:
    laps = {car.submission: car.laps for car in result.cars}
    cars = []
    for name in [car.submission for car in result.cars] or names:
        submission, driven = stored.submissions[name], laps.get(name, [])
        times = [lap.lap_s for lap in driven if lap.complete]
        figures = figures_of(driven, 1)
        cars.append(
            RunCar(
                submission_id(name),
                submission.racer,
                submission.model,
                len(times),
                len(driven),
                min(times, default=None),
                sum(times) if times else None,
                figures.clean,
                f"{words.laps_of(figures)}, best {words.time_of(figures.best)}"
                if times
                else words.laps_of(figures),
            )
        )
    return RaceRun(
        f"{'+'.join(map(submission_id, names))}-{result.restarts}-{result.session}",
        state,
        result.began_at,
        result.ended_at,
        cars,
        result.message,
    )
