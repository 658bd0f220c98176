"""How races are written about."""

import math
from collections.abc import Sequence

from drcli.config.race_types import RACE_TYPES
from drcli.races.lap_ranking import LapFigures, sum_s
from drcli.races.race_records import DrivenLap, RaceRules
from drcli.races.race_settings import shown_settings
from drcli.records.iteration import counted_resets
from drcli.records.iteration import lap_time as time_with_penalty

NONE = "\N{EN DASH}"


def lap_time(seconds: float | None) -> str:
    """As the consoles write it: 0:13.600."""
    if seconds is None:
        return NONE
    thousandths = round(seconds * 1000)
    minutes, rest = divmod(thousandths, 60_000)
    return f"{minutes}:{rest // 1000:02d}.{rest % 1000:03d}"


def time_of(laps: Sequence[DrivenLap], average_laps: int = 1) -> str:
    """0:12.800 = 0:07.800 driven + 5.00 penalty; divided by `average_laps`."""
    if not laps:
        return NONE
    seconds = sum_s(laps) / average_laps
    penalty_s = math.fsum(lap.penalty_s or 0.0 for lap in laps) / average_laps
    resets = sum(lap.resets for lap in laps)
    return time_with_penalty(seconds, penalty_s, resets, lap_time)


def laps_of(figures: LapFigures) -> str:
    text = f"{figures.clean} of {figures.driven} clean"
    if figures.complete > figures.clean:
        text += f", {figures.complete} finished"
    return f"{text}, {counted_resets(figures.resets)}" if figures.resets else text


def lap_of(lap: DrivenLap) -> str:
    text = time_of([lap])
    return text if lap.complete else f"{text}, {lap.status.lower()}"


def kind(rules: RaceRules) -> str:
    return RACE_TYPES[rules.race_type].words


def decides(rules: RaceRules) -> str:
    if rules.in_pairs:
        if rules.pairing == "bracket":
            return "Bracket: the winner of each pair goes on."
        return "Round robin: 1 point for each pair won, half a point for both if nobody wins."
    laps = f"{rules.max_laps} lap{'s' * (rules.max_laps != 1)}"
    if rules.ranking == "best-lap":
        least = f"; {rules.min_laps} must be complete" if rules.min_laps > 1 else ""
        return f"Best of {laps}{least}."
    if rules.ranking == "total-time":
        return f"Total time of {laps}, all complete."
    return f"Best average of {rules.average_laps} consecutive complete laps, of {laps}."


def penalties(rules: RaceRules) -> str:
    return (
        f"Off track: {rules.off_track_penalty_s:g} s. Collision: {rules.collision_penalty_s:g} s. "
        "Times contain both."
    )


def conditions(rules: RaceRules) -> str:
    return ", ".join(f"{name}={text}" for name, text in shown_settings(rules).items())


def laps_in_pair(laps: Sequence[DrivenLap]) -> str:
    complete = [lap for lap in laps if lap.complete]
    if not complete:
        return "no complete lap"
    count, clean = len(complete), sum(lap.clean for lap in complete)
    word = f"lap{'s' * (count != 1)}"
    driven = f"{count} clean {word}" if clean == count else f"{count} {word} ({clean} clean)"
    return f"{driven} in {time_of(complete)}"
