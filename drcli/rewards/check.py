"""Checks a reward function on the configured track and race."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Annotated

import numpy as np

from drcli.base.errors import Problem, of_severity
from drcli.base.report import BLANK, Col, Curve, Styled, View, bold, compact, counted, dim, table
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.model.files.custom_files import InputFile
from drcli.model.keys import HYPERPARAMETERS_FILE, MODEL_METADATA_FILE
from drcli.rewards.course import (
    FAST,
    LATE,
    LEAVING,
    STANDING,
    STEADY,
    Course,
    each_race,
    require_trainable,
)
from drcli.rewards.lint import SIMULATION_STEP_S
from drcli.rewards.sandbox.run_sandbox import CallIndex, Difference, FailureKind
from drcli.rewards.source import own_file, read_racers_file
from drcli.rewards.tried_reward import SandboxOf, TriedReward, as_array, try_rewards
from drcli.rewards.try_inputs import races_of, text_of, tolerated_share

# Finds what a drive shows of a reward function.
#
# Loopholes lead a car away from a fast lap. Rewards that depend on chance or earlier episodes
# cannot be learned.


_DIGITS, _ALL_DIGITS = 4, 17
_FATAL: tuple[FailureKind, ...] = ("load", "signature", "endless", "ends", "crashes")
_SAME = 1e-9
_GROWS = 3.0
_TIE = 0.05
_NEARLY = 0.95
_CREEPING_MPS = 0.5
_NOTHING = 0.01
_OF_LAPS = {"short", "standing", "cancels-out", "slow-lap"}
_BETTER = "Pay for progress per step, or for a lap in few steps."


def course_problems(tried: TriedReward, discount: float) -> Iterator[Problem]:
    yield from _memory(tried)
    if not any(failure.kind in _FATAL for failure in tried.result.failures):
        yield from _loopholes(tried, discount)


def _loopholes(tried: TriedReward, discount: float) -> Iterator[Problem]:
    values = np.concatenate([tried.drive_values, tried.grid_values.reshape(-1)])
    values = values[~np.isnan(values)]
    if not len(values):
        return
    tried_actions = as_array([*values, *tried.samples])
    if np.nanmax(tried_actions) - np.nanmin(tried_actions) <= _SAME * max(abs(values.max()), 1.0):
        yield tried.warning(
            "constant",
            f"It always pays {values[0]:.4g}: the car learns at most to stay on the road for a "
            "long time, slowly or in circles.",
            "Pay more for what you want, such as being near the centre line, or being fast.",
        )
        return
    yield from _growth(tried, float(np.abs(values).max()))
    if tried.result.memory is None:  # else the reward depends on more than the place
        if tried.result.random is None:  # else places differ by chance
            yield from _off_track(tried)
        yield from _laps(tried, discount)


def _growth(tried: TriedReward, greatest: float) -> Iterator[Problem]:
    late = tried.samples[LATE] if tried.samples else None
    if late is not None and abs(late) > max(_GROWS * greatest, 1.0):
        yield tried.warning(
            "unbounded",
            f"It grows without end: late in a very long episode one step pays {late:,.4g}; on the "
            f"whole drive no step pays more than {greatest:,.4g}. So a long episode is worth more "
            "than a good one.",
            "Limit it, as in min(reward, 10.0), or pay for the pace: progress / steps.",
        )


def _off_track(tried: TriedReward) -> Iterator[Problem]:
    values, off = tried.grid_values, np.array(tried.course.off)
    outside, centre = values[off], values[len(values) // 2]
    if np.isnan(outside).all() or np.isnan(centre).all():
        return
    off_mean, on_mean = float(np.nanmean(outside)), float(np.nanmean(centre))
    driven = max(abs(tried.mean(driver) or 0.0) for driver in (STEADY, FAST))
    if max(abs(off_mean), abs(on_mean)) < _NOTHING * driven:
        return  # the speed or the steering of the places earns nothing anywhere
    if off_mean >= on_mean - (1.0 - _NEARLY) * abs(on_mean):
        yield tried.warning(
            "off-track",
            "A car with all wheels off the road earns as much as one on the centre line "
            f"({off_mean:.3g} and {on_mean:.3g} per step).",
            'Return almost nothing if params["is_offtrack"], or if not '
            'params["all_wheels_on_track"].',
        )


def _laps(tried: TriedReward, discount: float) -> Iterator[Problem]:
    """At most one; none if the actions do not keep the car on the road."""
    if not tried.trip(STEADY).on_the_road:
        return
    steady, left = tried.total(STEADY), tried.total(LEAVING)
    if steady is not None and left is not None and left >= steady:
        yield tried.warning(
            "short",
            f"Leaving the road soon earns {left:.4g}, a whole lap earns {steady:.4g}: the car "
            "learns to end the episode.",
            "Pay more than zero for a good step, so that a longer episode earns more.",
        )
        return
    creeping, fast, prefers_fast = _creeping(tried), tried.total(FAST), tried.prefers_fast
    if steady is None or fast is None or prefers_fast is None:
        if creeping:
            yield tried.warning("standing", creeping, _BETTER)
        return
    both = (
        f"{steady:,.4g} in {tried.trip(STEADY).seconds:.1f} s and "
        f"{fast:,.4g} in {tried.trip(FAST).seconds:.1f} s"
    )
    found = None
    if abs(steady - fast) <= _TIE * max(abs(steady), abs(fast)):
        found = tried.warning(
            "cancels-out",
            f"A slow lap earns as much as a fast one ({both}): the fast one earns more per step, "
            f"but has fewer steps. {creeping}".strip(),
            "Pay more than twice as much for twice the speed, such as the square of the speed, or "
            "pay for a complete lap by the number of its steps.",
        )
    elif not prefers_fast:
        found = tried.warning(
            "standing" if creeping else "slow-lap",
            f"A slow lap earns more than a fast one ({both}), so the car has no reason to get "
            f"faster. {creeping}".strip(),
            f"{_BETTER} For learning to stay on the road it is fine as it is.",
        )
    elif creeping:
        found = tried.warning("standing", creeping, _BETTER)
    if found is not None:
        slow, quick = (tried.discounted(driver, discount) for driver in (STEADY, FAST))
        if found.rule == "slow-lap" and not slow > quick + _TIE * abs(quick):
            return  # so many functions pay for good steps alone, and their cars get fast
        if quick > slow + _TIE * abs(slow):
            why = (
                f" But a step counts less the later it comes (discount_factor {discount:g}): seen "
                f"from the start, the fast lap is worth {quick:,.4g}, the slow one {slow:,.4g}."
            )
            message = found.message.replace(", so the car has no reason to get faster", "")
            found = replace(found, severity="note", message=message + why)
        yield found


def _creeping(tried: TriedReward) -> str:
    step, standing, trip = tried.mean(STEADY), tried.mean(STANDING), tried.trip(STANDING)
    gone_m = trip.progress / 100.0 * tried.course.length_m
    speed_mps = gone_m / max(trip.seconds, 1.0)
    if speed_mps > _CREEPING_MPS or step is None or standing is None:
        return ""
    if not standing >= _NEARLY * step > 0:
        return ""
    return f"Creeping at {speed_mps:.1f} m/s earns {standing:.3g} per step, as much as driving."


def _memory(tried: TriedReward) -> Iterator[Problem]:
    random, memory = tried.result.random, tried.result.memory
    if random is not None:
        yield tried.warning(
            "random",
            f"The reward changes when the same drive is repeated: {_both(tried, random, 'and')}.",
            "Remove random numbers and clocks: the car also learns from noise in the reward.",
        )
    if memory is not None:
        yield tried.warning(
            "memory",
            "For the same parameters the reward depends on earlier calls: "
            f"{_both(tried, memory, 'or')}. It remembers something from earlier episodes.",
            'Reset it when an episode begins (`params["steps"] <= 2`), or do without it.',
        )


def _both(tried: TriedReward, difference: Difference, word: str) -> str:
    values, digits = (difference.value, difference.other), _DIGITS
    while True:
        one, other = ("a failure" if value is None else f"{value:.{digits}g}" for value in values)
        if one != other or digits == _ALL_DIGITS:
            break
        digits += 1
    often = f"{difference.times:,} of {difference.of:,} calls"
    return f"{one} {word} {other} ({tried.describe(difference.place)}; {often})"


@dataclass(frozen=True)
class Extreme:
    """The least or the greatest reward."""

    reward: Annotated[float, "The reward."]
    place: Annotated[str, "At which step, in words."]

    def __str__(self) -> str:
        return f"{compact(self.reward)}: {self.place}"


@dataclass(frozen=True)
class DriverReport:
    """The rewards of one driver."""

    name: Annotated[str, "The driver.", Col("driver")]
    about: Annotated[str, "Its way of driving."]
    steps: Annotated[int, "Steps with a reward.", Col("steps")]
    seconds: Annotated[float, "Simulated time.", Col("time", "{:.1f} s")]
    progress: Annotated[float, "Percent of the lap.", Col("progress", "{:.0f} %")]
    end: Annotated[
        str,
        "How it ended, in the words of traces.",
        Col("ended", lambda end: end.replace("_", " ")),
    ]
    total: Annotated[
        float | None,
        "Sum of all rewards; None if a call failed.",
        Col("reward", compact, none="failed"),
    ]
    mean: Annotated[
        float | None, "Reward per step; None if a call failed.", Col("per step", compact, none="")
    ]


@dataclass(frozen=True)
class ParameterReport:
    """The values of a parameter during the drive."""

    name: Annotated[str, "Its name."]
    least: Annotated[float | None, "Least value, over all items of a list; None for an empty one."]
    greatest: Annotated[float | None, "Greatest value."]
    read: Annotated[bool, "Whether its name appears in the function."]


@dataclass(frozen=True)
class TimeReport:
    """The duration of calls, in microseconds."""

    median_us: Annotated[float, "Median of all calls."]
    mean_us: Annotated[float, "Mean of all calls."]
    worst_us: Annotated[float, "The longest call."]
    worst_place: Annotated[str, "Place of that call."]
    slower_percent: Annotated[float, "How much longer the simulation takes because of it."]

    def __str__(self) -> str:
        median, worst = _duration(self.median_us), _duration(self.worst_us)
        longer = f"driving takes {self.slower_percent:.1f} % longer"
        return f"{median} per call, worst {worst}; {longer}"


@dataclass(frozen=True)
class OtherRace:
    """Another worker's race."""

    world: Annotated[str, "The track."]
    race_type: Annotated[str, "The race."]
    reversed: Annotated[bool, "Whether it is driven against the track's direction."]
    calls: Annotated[int, "Calls that were made."]

    def __str__(self) -> str:
        direction = ", reversed" if self.reversed else ""
        return f"{self.world}, {self.race_type}{direction}, {counted(self.calls, 'call')}"


@dataclass(frozen=True)
class RewardReport:
    """The result of a check, with numbers of the first worker's race."""

    file: Annotated[str, "The file."]
    world: Annotated[str, "The track."]
    race_type: Annotated[str, "The race."]
    reversed: Annotated[bool, "Whether it is driven against the track's direction."]
    calls: Annotated[int, "Calls that were made."]
    returns: Annotated[list[str], "Types that it returned."]
    least: Annotated[Extreme | None, "Least reward."]
    mean: Annotated[float | None, "Their mean."]
    greatest: Annotated[Extreme | None, "Greatest reward."]
    time: Annotated[TimeReport | None, "Duration of calls."]
    parameters: Annotated[list[ParameterReport], "All parameters."]
    drivers: Annotated[list[DriverReport], "Rewards of each driver."]
    curve: Annotated[list[float | None], "The steady driver's reward at each step."]
    errors: Annotated[list[Problem], "Problems that end a training or do harm, in any race."]
    warnings: Annotated[list[Problem], "Problems that may surprise its author, in any race."]
    notes: Annotated[list[Problem], "What is good to know, in any race."]
    others: Annotated[list[OtherRace], "Races of other workers."]

    @property
    def works(self) -> bool:
        """Whether a training can use it."""
        return not self.errors

    def view(self) -> View:
        reads = [parameter.name for parameter in self.parameters if parameter.read]
        unread = len(self.parameters) - len(reads)
        state = Styled("works", "bold green") if self.works else Styled("does not work", "bold red")
        yield (bold(self.file), " ", state)
        yield dim(f"on {OtherRace(self.world, self.race_type, self.reversed, self.calls)}")
        yield from (dim(f"and on {other}") for other in self.others)
        yield {
            "returns": ", ".join(self.returns),
            "least": self.least and str(self.least),
            "mean": None if self.mean is None else compact(self.mean),
            "greatest": self.greatest and str(self.greatest),
            "time": self.time and str(self.time),
            "reads": ", ".join(reads) if unread or not reads else f"all {len(reads)} parameters",
        }
        if any(driver.total is not None for driver in self.drivers):
            yield from (BLANK, table(self.drivers))
            yield Curve("steady lap ", [value for value in self.curve if value is not None])
        kinds = [
            (title, item)
            for title, items in (
                (Styled("Error: ", "bold red"), self.errors),
                (Styled("Warning: ", "bold yellow"), self.warnings),
                (Styled("Note: ", "bold"), self.notes),
            )
            for item in items
        ]
        for title, problem in kinds:
            yield from (BLANK, (title, problem.where, dim(f" ({problem.rule})")))
            yield [problem.message, (dim("Try: "), problem.remedy)]


def _duration(microseconds: float) -> str:
    if microseconds < 1e3:
        return f"{microseconds:.1f} \N{MICRO SIGN}s"
    if microseconds < 1e6:
        return f"{microseconds / 1e3:.1f} ms"
    return f"{microseconds / 1e6:.1f} s"


def check(settings: Settings, file: Path | None, directory: Path) -> RewardReport:
    """Try a reward function on each worker's track.

    Raises:
        SettingsError: File or track is missing, or the race does not fit.
    """
    read = read_racers_file(settings, file, directory)
    tried = try_in_each_race(settings, read, directory, lambda own, _: own)
    return report_of(tried, tried[0].result.discount)


def try_in_each_race(
    settings: Settings,
    file: InputFile,
    directory: Path,
    course_of: Callable[[DriveConfig, str], Course | DriveConfig],
    given_up: Event | None = None,
    sandbox_of: SandboxOf | None = None,
) -> list[TriedReward]:
    """As before a start, and on the course of each distinct race.

    The first result has the samples of all races. `course_of` gets a race and the model's metadata.
    """
    tried: list[TriedReward] = []
    tolerated = tolerated_share(settings.run)
    metadata, hyperparameters = (
        text_of(own_file(settings, name)) for name in (MODEL_METADATA_FILE, HYPERPARAMETERS_FILE)
    )
    for own in each_race(settings.races):
        require_trainable(own)
        races = None if tried else races_of(settings.run)
        course = course_of(own, metadata)
        if given_up is not None and given_up.is_set():
            break
        tried += try_rewards(
            [file],
            course,
            directory,
            races=races,
            tolerated=tolerated,
            given_up=given_up,
            metadata=metadata,
            hyperparameters=hyperparameters,
            sandbox_of=sandbox_of,
        )
    return tried


def report_of(races: Sequence[TriedReward], discount: float) -> RewardReport:
    """On the first race, with problems that only show in others.

    `discount`: weight of a reward that comes one step later.
    """
    found: list[Problem] = []
    for each in races:
        course = each.course
        place = f"On {course.world}, {course.race_type}: " if each is not races[0] else ""
        known = {_sameness(problem) for problem in found}
        found += [
            replace(problem, message=place + problem.message)
            for problem in (*each.problems, *course_problems(each, discount))
            if _sameness(problem) not in known
        ]
    tried = races[0]
    course = tried.course
    paid = [
        (value, sequence, index)
        for sequence in range(len(course.trips))
        for index, value in enumerate(tried.result.values[sequence])
        if value is not None
    ]
    least, greatest = min(paid, default=None), max(paid, default=None)
    return RewardReport(
        file=tried.name,
        world=course.world,
        race_type=course.race_type,
        reversed=course.reversed,
        calls=tried.result.calls,
        returns=sorted(tried.result.returned),
        least=_extreme(tried, least),
        mean=sum(reward for reward, _, _ in paid) / len(paid) if paid else None,
        greatest=_extreme(tried, greatest),
        time=_time(tried),
        parameters=_parameters(tried),
        drivers=[
            DriverReport(
                trip.driver.name,
                trip.driver.about,
                len(trip.calls),
                round(trip.seconds, 3),
                round(trip.progress, 2),
                trip.end,
                tried.total(trip.driver),
                tried.mean(trip.driver),
            )
            for trip in course.trips
        ],
        curve=tried.result.values[0],
        errors=list(of_severity(found, "error")),
        warnings=list(of_severity(found, "warning")),
        notes=list(of_severity(found, "note")),
        others=[
            OtherRace(course.world, course.race_type, course.reversed, each.result.calls)
            for each in races[1:]
            for course in [each.course]
        ],
    )


def _sameness(problem: Problem) -> tuple[str, str]:
    return "laps" if problem.rule in _OF_LAPS else problem.rule, problem.where


def _extreme(tried: TriedReward, found: tuple[float, int, int] | None) -> Extreme | None:
    if found is None:
        return None
    reward, sequence, index = found
    return Extreme(reward, tried.describe(CallIndex(sequence=sequence, index=index)))


def _time(tried: TriedReward) -> TimeReport | None:
    timing = tried.result.timing
    if timing is None:
        return None
    return TimeReport(
        median_us=round(timing.median_s * 1e6, 3),
        mean_us=round(timing.mean_s * 1e6, 3),
        worst_us=round(timing.worst_s * 1e6, 3),
        worst_place=tried.describe(timing.worst),
        slower_percent=round(100 * timing.mean_s / SIMULATION_STEP_S, 2),
    )


def _parameters(tried: TriedReward) -> list[ParameterReport]:
    course = tried.course
    calls = [
        {**call, "waypoints": course.waypoints[course.reversed]}
        for trip in course.trips
        for call in trip.calls
    ]
    found = []
    for name in sorted(calls[0]):
        # The waypoints are the same object in all calls.
        values = {id(call[name]): call[name] for call in calls}.values()
        numbers = [number for value in values for number in _numbers(value)]
        least, greatest = min(numbers, default=None), max(numbers, default=None)
        found.append(ParameterReport(name, least, greatest, name in tried.reads))
    return found


def _numbers(value: object) -> Iterator[float]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float):
        yield float(value)
