"""A wanted race, and its rules."""

import secrets
from dataclasses import dataclass
from datetime import UTC, datetime

from drcli.base.clock import date_or_span
from drcli.base.errors import SettingsError, one_of, shown
from drcli.config.race_types import RaceKind
from drcli.config.settings import Settings
from drcli.model.files.sensors import SENSORS
from drcli.races.race_records import Pairing, RaceRules, Ranking
from drcli.races.race_settings import frozen_settings, settings_of_rules
from drcli.races.standings import date_text

LONGEST_NAME = 64
MOST_LAPS = 100

MOST_PENALTY_S = 600.0

RACE_SENSORS = tuple(name for name, sensor in SENSORS.items() if not sensor.alias_of)


@dataclass(frozen=True)
class RaceOptions:
    """A wanted race. None: the setting, else the default.

    Attributes:
        average_laps: Consecutive.
        max_submissions: Of one racer; 0 for any number; None for 1 in pairs, else any number.
        opens_at: Unix seconds; None for at once.
        closes_at: Unix seconds; None for never.
        sensors: Allowed ones; empty for any.
        settings: DR_ names and texts.
    """

    name: str
    world: str | None = None
    reverse: bool = False
    race_type: RaceKind | None = None
    ranking: Ranking = "best-lap"
    max_laps: int = 3
    min_laps: int | None = None
    average_laps: int | None = None
    off_track_penalty_s: float | None = None
    collision_penalty_s: float | None = None
    max_submissions: int | None = None
    opens_at: float | None = None
    closes_at: float | None = None
    seed: int | None = None
    pairing: Pairing = "round-robin"
    sensors: tuple[str, ...] = ()
    settings: tuple[tuple[str, str], ...] = ()


def rules_of(settings: Settings, options: RaceOptions, now_s: float) -> RaceRules:
    """Raises SettingsError for a wrong rule."""
    name = checked_name(options.name, "the race")
    race_type = options.race_type or "TIME_TRIAL"
    _check_number("--laps", options.max_laps, 1, MOST_LAPS)
    average = (
        usual_average(options.max_laps) if options.average_laps is None else options.average_laps
    )
    _check_number("--average-laps", average, 1, options.max_laps)
    usual = least_laps(options.ranking, options.max_laps, average)
    least = usual if options.min_laps is None else options.min_laps
    _check_number("--min-laps", least, 1, options.max_laps)
    if options.ranking == "best-average" and least < average:
        raise SettingsError(
            f"--min-laps {least} is less than the {average} laps in a row that best-average needs.",
            remedy="Leave --min-laps out, or lower --average-laps.",
        )
    if options.ranking == "total-time" and least != options.max_laps:
        raise SettingsError(
            f"--min-laps {least} does not fit total-time, which needs all {options.max_laps} laps.",
            remedy="Leave --min-laps out.",
        )
    penalties = {
        "--off-track-penalty": (options.off_track_penalty_s, settings.eval_off_track_penalty),
        "--collision-penalty": (options.collision_penalty_s, settings.eval_collision_penalty),
    }
    seconds = [own if given is None else given for given, own in penalties.values()]
    for option, value in zip(penalties, seconds, strict=True):
        _check_number(option, value, 0, MOST_PENALTY_S)
    most = options.max_submissions
    if most is None:
        most = int(race_type == "HEAD_TO_MODEL")
    _check_number("--max-submissions", most, 0, 1000)
    if options.closes_at is not None and options.closes_at <= (options.opens_at or now_s):
        raise SettingsError(
            f"The race would close at {date_text(options.closes_at)}, before it opens.",
            remedy="Choose a later time with --closes.",
        )
    for sensor in options.sensors:
        if sensor not in RACE_SENSORS:
            raise SettingsError(
                f"--sensor {shown(sensor)} is not a sensor.", remedy=one_of(RACE_SENSORS, sensor)
            )
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    _check_number("--seed", seed, 0, 2**32 - 1)
    rules = RaceRules(
        name=name,
        created_at=now_s,
        world=options.world or settings.world_name,
        reverse=options.reverse,
        race_type=race_type,
        ranking=options.ranking,
        max_laps=options.max_laps,
        min_laps=least,
        average_laps=average,
        off_track_penalty_s=seconds[0],
        collision_penalty_s=seconds[1],
        max_submissions=most,
        opens_at=options.opens_at,
        closes_at=options.closes_at,
        seed=seed,
        pairing=options.pairing,
        sensors=list(options.sensors),
        settings={**frozen_settings(settings, race_type), **dict(options.settings)},
    )
    settings_of_rules(settings, rules)  # refuses a wrong value before anything is written
    return rules


def object_settings(race_type: RaceKind, obstacles: int | None, bots: int | None) -> dict[str, str]:
    """Raises SettingsError for a race without such objects."""
    found = {}
    if obstacles is not None:
        if race_type != "OBJECT_AVOIDANCE":
            raise SettingsError(
                "--obstacles needs --type OBJECT_AVOIDANCE.", remedy="Leave --obstacles out."
            )
        # Fixed positions would outdo the number.
        found = {"DR_OA_NUMBER_OF_OBSTACLES": str(obstacles), "DR_OA_OBJECT_POSITIONS": ""}
    if bots is not None:
        if race_type != "HEAD_TO_BOT":
            raise SettingsError("--bots needs --type HEAD_TO_BOT.", remedy="Leave --bots out.")
        found["DR_H2B_NUMBER_OF_BOT_CARS"] = str(bots)
    return found


def usual_average(max_laps: int) -> int:
    return min(3, max_laps)


def least_laps(ranking: Ranking, max_laps: int, average_laps: int) -> int:
    return {"best-lap": 1, "best-average": average_laps, "total-time": max_laps}[ranking]


def checked_name(name: str, whose: str) -> str:
    """With single spaces.

    Raises:
        SettingsError: It is empty, too long, or cannot be shown.
    """
    words = " ".join(name.split())
    if not words or len(words) > LONGEST_NAME or not words.isprintable():
        what = "is empty" if not words else "is too long"
        if words and not words.isprintable():
            what = "has characters that cannot be shown"
        raise SettingsError(
            f"The name of {whose}, {shown(name)!r}, {what}.",
            remedy=f"Write 1 to {LONGEST_NAME} letters, digits and other printable characters.",
        )
    return words


def _check_number(option: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise SettingsError(
            f"{option} {value:g} is not from {low:g} to {high:g}.",
            remedy=f"Write a number from {low:g} to {high:g}.",
        )


# Reads when a race opens and closes.


_LATEST_S = 1e10


def parse_time(option: str, text: str, now_s: float) -> float:
    """Unix seconds of 2026-11-20T18:30 (UTC), 2026-11-20T18:30+01:00, or 90m, 2h, 7d from now.

    Raises:
        SettingsError: It is none of these.
    """
    try:
        at = date_or_span(text, datetime.fromtimestamp(now_s, UTC), 1).timestamp()
        if not 0.0 <= at <= _LATEST_S:
            raise ValueError
        return at
    except (ValueError, OverflowError):
        raise SettingsError(
            f"{option} {shown(text)} is neither a date nor a time from now.",
            remedy="Write a date in UTC such as 2026-11-20T18:30, or a time from now such as 2h.",
        ) from None
