"""Finds what a drive shows of a reward function.

Loopholes lead a car away from a fast lap. Rewards that depend on chance or earlier episodes cannot
be learned.
"""

from collections.abc import Iterator

import numpy as np

from drcli.base.problems import Problem
from drcli.rewards.course import TriedReward
from drcli.rewards.drivers import FAST, LEAVING, STANDING, STEADY
from drcli.rewards.sandbox.sample_calls import LATE
from drcli.rewards.sandbox.sandbox_records import Difference, FailureKind

_DIGITS, _ALL_DIGITS = 4, 17
_FATAL: tuple[FailureKind, ...] = ("load", "signature", "endless", "ends", "crashes")
_SAME = 1e-9
_GROWS = 3.0
_TIE = 0.05
_NEARLY = 0.95
_BETTER = "Pay for progress per step, or for a lap in few steps."


def drive_problems(tried: TriedReward) -> Iterator[Problem]:
    yield from _memory(tried)
    if not any(failure.kind in _FATAL for failure in tried.result.failures):
        yield from _loopholes(tried)


def _loopholes(tried: TriedReward) -> Iterator[Problem]:
    values = np.concatenate([tried.drive_values, tried.grid_values.reshape(-1)])
    values = values[~np.isnan(values)]
    if not len(values):
        return
    if np.ptp(values) <= _SAME * max(abs(values.max()), 1.0):
        yield tried.warning(
            "constant",
            f"It always pays {values[0]:.4g}: the car learns at most to stay on the road for a "
            "long time, slowly or in circles.",
            "Pay more for what you want, such as being near the centre line, or being fast.",
        )
        return
    yield from _growth(tried, float(np.abs(values).max()))
    if tried.result.memory is None:  # else the reward depends on more than the place
        yield from _off_track(tried)
        yield from _laps(tried)


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
    values, off = tried.grid_values, tried.course.grid.off
    outside, centre = values[off], values[len(values) // 2]
    if np.isnan(outside).all() or np.isnan(centre).all():
        return
    off_mean, on_mean = float(np.nanmean(outside)), float(np.nanmean(centre))
    if off_mean >= on_mean - (1.0 - _NEARLY) * abs(on_mean):
        yield tried.warning(
            "off-track",
            "A car with all wheels off the road earns as much as one on the centre line "
            f"({off_mean:.3g} and {on_mean:.3g} per step).",
            'Return almost nothing if params["is_offtrack"], or if not '
            'params["all_wheels_on_track"].',
        )


def _laps(tried: TriedReward) -> Iterator[Problem]:
    steady, left = tried.total(STEADY), tried.total(LEAVING)
    if steady is not None and left is not None and left >= steady:
        yield tried.warning(
            "short",
            f"Leaving the road soon earns {left:.4g}, a whole lap earns {steady:.4g}: the car "
            "learns to end the episode.",
            "Pay more than zero for a good step, so that a longer episode earns more.",
        )
        return
    step, standing = tried.mean(STEADY), tried.mean(STANDING)
    creeping = ""
    if step is not None and standing is not None and standing >= _NEARLY * step > 0:
        creeping = f"Creeping at 0.1 m/s earns {standing:.3g} per step, as much as driving."
    fast, prefers_fast = tried.total(FAST), tried.prefers_fast
    if steady is None or fast is None or prefers_fast is None:
        if creeping:
            yield tried.warning("standing", creeping, _BETTER)
        return
    both = (
        f"{steady:,.4g} in {tried.trip(STEADY).seconds:.1f} s and "
        f"{fast:,.4g} in {tried.trip(FAST).seconds:.1f} s"
    )
    if abs(steady - fast) <= _TIE * max(abs(steady), abs(fast)):
        yield tried.warning(
            "cancels-out",
            f"A slow lap earns as much as a fast one ({both}): the fast one earns more per step, "
            f"but has fewer steps. {creeping}".strip(),
            "Pay more than twice as much for twice the speed, such as the square of the speed, or "
            "pay for a complete lap by the number of its steps.",
        )
    elif not prefers_fast:
        yield tried.warning(
            "standing" if creeping else "slow-lap",
            f"A slow lap earns more than a fast one ({both}), so the car has no reason to get "
            f"faster. {creeping}".strip(),
            f"{_BETTER} For learning to stay on the road it is fine as it is.",
        )
    elif creeping:
        yield tried.warning("standing", creeping, _BETTER)


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
    return f"{one} {word} {other} ({tried.course.describe(difference.place)}; {often})"
