"""Checks a reward function on the configured track, in the configured race."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.checks.sandbox.statement import Place
from drcli.config.settings import Settings
from drcli.rewards.lint import SIMULATION_STEP_S, Remark, remarks
from drcli.rewards.scripted_drive import drive, each_race
from drcli.rewards.source import display_name, file_of
from drcli.rewards.trial import Course, Trial, try_out
from drsim.episode.reward import RewardParams


@dataclass(frozen=True)
class Extreme:
    """The least or the greatest reward.

    Attributes:
        reward: How much.
        place: Where, in words.
    """

    reward: float
    place: str


@dataclass(frozen=True)
class DriverReport:
    """What one driver earned.

    Attributes:
        name: The driver.
        about: What it does.
        steps: Steps that were paid.
        seconds: Simulated time.
        progress: Percent of the lap.
        end: How it ended, in the words of traces.
        total: Sum of all rewards; None where a call failed.
        mean: Reward a step; likewise.
    """

    name: str
    about: str
    steps: int
    seconds: float
    progress: float
    end: str
    total: float | None
    mean: float | None


@dataclass(frozen=True)
class ParameterReport:
    """A parameter and what it was during the drive.

    Attributes:
        name: Its name.
        least: Least value, over all items of a list; None for an empty one.
        greatest: Greatest value.
        read: The function looked at it.
    """

    name: str
    least: float | None
    greatest: float | None
    read: bool


@dataclass(frozen=True)
class TimeReport:
    """How long calls took.

    Attributes:
        median_us: The usual call, microseconds.
        mean_us: Their mean.
        worst_us: The longest.
        worst_place: Which one that was.
        slower_percent: By how much driving takes longer for it.
    """

    median_us: float
    mean_us: float
    worst_us: float
    worst_place: str
    slower_percent: float


@dataclass(frozen=True)
class OtherRace:
    """A race of another worker that the function was tried in too.

    Attributes:
        world: The track.
        race_type: The race.
        reversed: Driven against the direction of the track.
        calls: Calls that were made.
    """

    world: str
    race_type: str
    reversed: bool
    calls: int


@dataclass(frozen=True)
class RewardReport:
    """All that a check has found out; numbers and drivers are those of the first worker's race.

    Attributes:
        file: The file.
        world: The track.
        race_type: The race.
        reversed: Driven against the direction of the track.
        calls: Calls that were made.
        returns: Types that it returned.
        least: The least reward.
        mean: Their mean.
        greatest: The greatest reward.
        time: How long it took.
        parameters: All parameters.
        drivers: What each driver earned.
        curve: What the steady driver earned at each step.
        errors: What ends a training or does harm, in any race.
        warnings: What may surprise, likewise.
        others: Races of other workers that it was tried in too.
    """

    file: str
    world: str
    race_type: str
    reversed: bool
    calls: int
    returns: list[str]
    least: Extreme | None
    mean: float | None
    greatest: Extreme | None
    time: TimeReport | None
    parameters: list[ParameterReport]
    drivers: list[DriverReport]
    curve: list[float | None]
    errors: list[Remark]
    warnings: list[Remark]
    others: list[OtherRace]

    @property
    def works(self) -> bool:
        """Whether a training can use it."""
        return not self.errors


def check(settings: Settings, file: Path | None, directory: Path) -> RewardReport:
    """Try a reward function on a drive over the configured track, or over that of each worker.

    Args:
        settings: The tracks, the races and the directions.
        file: The file; the one that a training would take when left out.
        directory: The racer's working folder.

    Raises:
        SettingsError: There is no such file or track, or the race does not fit on it.
    """
    path = file_of(settings, file)
    named = [(path, display_name(path, directory))]
    trials: list[Trial] = []
    for own in each_race(settings.races):
        trials += try_out(named, Course.of(drive(own)), directory)
    first, *others = map(report, trials)
    return _with_others(first, others)


def report(trial: Trial) -> RewardReport:
    """What a trial has shown."""
    found = remarks(trial)
    drive_ = trial.course.drive
    paid = list(_paid(trial))
    least, greatest = min(paid, default=None), max(paid, default=None)
    return RewardReport(
        file=trial.name,
        world=drive_.world,
        race_type=drive_.race_type,
        reversed=drive_.track.reverse,
        calls=trial.statement.made,
        returns=sorted(trial.statement.returned),
        least=_extreme(trial, least),
        mean=sum(reward for reward, _, _ in paid) / len(paid) if paid else None,
        greatest=_extreme(trial, greatest),
        time=_time(trial),
        parameters=_parameters(trial),
        drivers=[
            DriverReport(
                trip.pilot.name,
                trip.pilot.about,
                len(trip.calls),
                round(trip.seconds, 3),
                round(trip.progress, 2),
                trip.end,
                trial.total(trip.pilot),
                trial.mean(trip.pilot),
            )
            for trip in drive_.trips
        ],
        curve=trial.statement.values[0],
        errors=[remark for remark in found if remark.severity == "error"],
        warnings=[remark for remark in found if remark.severity == "warning"],
        others=[],
    )


def _with_others(first: RewardReport, others: list[RewardReport]) -> RewardReport:
    """A report with what other races have shown beside it."""
    errors, warnings = list(first.errors), list(first.warnings)
    for other in others:
        place = f"On {other.world}, {other.race_type}: "
        failing = {(remark.rule, remark.where) for remark in errors}
        odd = {remark.rule for remark in warnings}
        errors += [
            replace(remark, message=place + remark.message)
            for remark in other.errors
            if (remark.rule, remark.where) not in failing
        ]
        warnings += [
            replace(remark, message=place + remark.message)
            for remark in other.warnings
            if remark.rule not in odd
        ]
    races = [OtherRace(o.world, o.race_type, o.reversed, o.calls) for o in others]
    return replace(first, errors=errors, warnings=warnings, others=races)


def _paid(trial: Trial) -> Iterator[tuple[float, int, int]]:
    """Rewards of the drivers, with their places."""
    for sequence in range(len(trial.course.drive.trips)):
        for index, value in enumerate(trial.statement.values[sequence]):
            if value is not None:
                yield value, sequence, index


def _extreme(trial: Trial, found: tuple[float, int, int] | None) -> Extreme | None:
    if found is None:
        return None
    reward, sequence, index = found
    return Extreme(reward, trial.describe(Place(sequence=sequence, index=index)))


def _time(trial: Trial) -> TimeReport | None:
    timing = trial.statement.timing
    if timing is None:
        return None
    return TimeReport(
        median_us=round(timing.median_s * 1e6, 3),
        mean_us=round(timing.mean_s * 1e6, 3),
        worst_us=round(timing.worst_s * 1e6, 3),
        worst_place=trial.describe(timing.worst),
        slower_percent=round(100 * timing.mean_s / SIMULATION_STEP_S, 2),
    )


def _parameters(trial: Trial) -> list[ParameterReport]:
    drive_ = trial.course.drive
    calls = [
        {**call, "waypoints": drive_.track.waypoints}
        for trip in drive_.trips
        for call in trip.calls
    ]
    return [_parameter(name, calls, name in trial.statement.reads) for name in sorted(calls[0])]


def _parameter(name: str, calls: list[RewardParams], read: bool) -> ParameterReport:
    numbers = [number for value in _distinct(name, calls) for number in _numbers(value)]
    return ParameterReport(name, min(numbers, default=None), max(numbers, default=None), read)


def _distinct(name: str, calls: list[RewardParams]) -> list[object]:
    """Values of a parameter; lists that are the same object, such as the waypoints, only once."""
    return list({id(call[name]): call[name] for call in calls}.values())


def _numbers(value: object) -> Iterator[float]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float):
        yield float(value)
