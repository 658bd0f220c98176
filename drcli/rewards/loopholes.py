"""What a reward function pays for, as far as a drive can tell: the loopholes that cars find."""

from collections.abc import Iterator

from drcli.rewards.drivers import FAST, LEAVING, STANDING, STEADY
from drcli.rewards.trial import Trial

Worth = tuple[str, str, str]
"""Rule, message and remedy."""

_SAME = 1e-9
_GROWS = 3.0
"""How many times the greatest reward of the drive a late step may pay."""

_TIE = 0.05
"""Totals that differ by less are the same."""

_NEARLY = 0.95
"""Pay from this share on is as good."""

_BETTER = "Pay for progress per step, or for a lap in few steps."


def worth_remarks(trial: Trial) -> Iterator[Worth]:
    """What is odd about its values."""
    values = [
        value
        for sequence in trial.statement.values[: len(trial.course.drive.trips) + 1]
        for value in sequence
        if value is not None
    ]
    if not values:
        return
    if max(values) - min(values) <= _SAME * max(abs(max(values)), 1.0):
        yield (
            "constant",
            f"It always pays {values[0]:.4g}: the car learns at most to stay on the road for "
            "long, slowly or in circles.",
            "Pay more for what you want, such as being near the centre line, or being fast.",
        )
        return
    yield from _growth(trial, values)
    if trial.statement.memory is None:  # else it pays by what went before, not for the place
        yield from _off_track(trial)
        yield from _laps(trial)


def _growth(trial: Trial, values: list[float]) -> Iterator[Worth]:
    greatest = max(map(abs, values))
    late = trial.statement.values[-1][0]
    if late is not None and abs(late) > _GROWS * greatest and abs(late) > 1.0:
        name = next(iter(trial.course.unusual))
        yield (
            "unbounded",
            f"It grows without end: {name} one step pays {late:,.4g}, on the whole drive none "
            f"more than {greatest:,.4g}. Lasting long then counts for more than driving well.",
            "Bound it, as in min(reward, 10.0), or pay by the pace: progress / steps.",
        )


def _off_track(trial: Trial) -> Iterator[Worth]:
    field = trial.course.field
    pairs = list(zip(trial.field_values, field.off.reshape(-1).tolist(), strict=True))
    count = len(field.along_m)
    middle = len(field.off) // 2
    beside = [value for value, off in pairs if off and value is not None]
    centre = [
        value
        for value in trial.field_values[middle * count : (middle + 1) * count]
        if value is not None
    ]
    if not beside or not centre:
        return
    off_mean, on_mean = sum(beside) / len(beside), sum(centre) / len(centre)
    if off_mean >= on_mean - (1.0 - _NEARLY) * abs(on_mean):
        yield (
            "off-track",
            f"A car with all wheels off the road is paid as well as one on the centre line "
            f"({off_mean:.3g} and {on_mean:.3g} a step).",
            'Return next to nothing where params["is_offtrack"], or not '
            'params["all_wheels_on_track"].',
        )


def _laps(trial: Trial) -> Iterator[Worth]:
    steady, left = trial.total(STEADY), trial.total(LEAVING)
    step, standing = trial.mean(STEADY), trial.mean(STANDING)
    if steady is not None and left is not None and left >= steady:
        yield (
            "short",
            f"Leaving the road soon earns {left:.4g}, a whole lap {steady:.4g}: the car learns to "
            "end the episode.",
            "Pay more than zero for a good step, so that lasting longer earns more.",
        )
        return
    creeping = ""
    if step is not None and standing is not None and standing >= _NEARLY * step > 0:
        creeping = f" A car that creeps at 0.1 m/s earns {standing:.3g} a step, as one that drives."
    fast = trial.total(FAST)
    whole = trial.trip(STEADY).whole and trial.trip(FAST).whole
    if steady is None or fast is None or not whole:
        if creeping:
            yield ("standing", creeping.strip(), _BETTER)
        return
    slow_s, fast_s = trial.trip(STEADY).seconds, trial.trip(FAST).seconds
    both = f"{steady:,.4g} in {slow_s:.1f} s and {fast:,.4g} in {fast_s:.1f} s"
    if abs(steady - fast) <= _TIE * max(abs(steady), abs(fast)):
        yield (
            "cancels-out",
            f"A slow lap earns as much as a fast one ({both}): more a step, but fewer steps."
            f"{creeping}",
            "Pay more than twice as much for twice the speed, such as its square, or a lap's end "
            "by its steps.",
        )
    elif steady > fast:
        rule = "standing" if creeping else "slow-lap"
        yield (
            rule,
            f"A slow lap earns more than a fast one ({both}), so the car has no reason to get "
            f"faster.{creeping}",
            f"{_BETTER} To learn to stay on the road it does as it is.",
        )
    elif creeping:
        yield ("standing", creeping.strip(), _BETTER)
