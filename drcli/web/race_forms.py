"""Reads forms about races; BadRequest where the page would not send it."""

import math
from typing import Any, get_args

from drcli.exchange.race_rules import Pairing, RaceKind, Ranking
from drcli.races.race_times import parse_time
from drcli.races.race_wish import RaceWish, object_settings
from drcli.web.answers import BadRequest, text_of

MOST_SENSORS = 20


def wish_of_form(body: dict[str, Any], now_s: float) -> RaceWish:
    """Null or missing: the usual value.

    Raises:
        BadRequest: The page would not send it.
        SettingsError: A time or a number of objects is wrong.
    """
    race_type: RaceKind = one_of_texts(body, "race_type", get_args(RaceKind), "TIME_TRIAL")
    objects = object_settings(
        race_type, whole_number(body, "obstacles"), whole_number(body, "bots")
    )
    laps = whole_number(body, "max_laps")
    opens, closes = text_of(body, "opens", "").strip(), text_of(body, "closes", "").strip()
    return RaceWish(
        name=text_of(body, "name"),
        world=text_of(body, "world", "").strip() or None,
        reverse=flag(body, "reverse"),
        race_type=race_type,
        ranking=one_of_texts(body, "ranking", get_args(Ranking), "best-lap"),
        max_laps=3 if laps is None else laps,
        min_laps=whole_number(body, "min_laps"),
        average_laps=whole_number(body, "average_laps"),
        off_track_penalty_s=number(body, "off_track_penalty_s"),
        collision_penalty_s=number(body, "collision_penalty_s"),
        max_submissions=whole_number(body, "max_submissions"),
        opens_at=parse_time("--opens", opens, now_s) if opens else None,
        closes_at=parse_time("--closes", closes, now_s) if closes else None,
        seed=whole_number(body, "seed"),
        pairing=one_of_texts(body, "pairing", get_args(Pairing), "round-robin"),
        sensors=tuple(texts(body, "sensors")),
        settings=tuple(objects.items()),
    )


def one_of_texts(body: dict[str, Any], key: str, known: tuple[str, ...], usual: str) -> Any:
    value = text_of(body, key, usual)
    if value not in known:
        raise BadRequest(f"The {key} is one of {', '.join(known)}.")
    return value


def number(body: dict[str, Any], key: str) -> float | None:
    """Null: None."""
    value = body.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadRequest(f"The {key} is not a number.")
    if not math.isfinite(value) or abs(value) > 1e15:
        raise BadRequest(f"The {key} is too large.")
    return value


def whole_number(body: dict[str, Any], key: str) -> int | None:
    """Null: None."""
    value = number(body, key)
    if value is not None and value != int(value):
        raise BadRequest(f"The {key} is not a whole number.")
    return None if value is None else int(value)


def flag(body: dict[str, Any], key: str) -> bool:
    value = body.get(key, False)
    if not isinstance(value, bool):
        raise BadRequest(f"The {key} is true or false.")
    return value


def texts(body: dict[str, Any], key: str) -> list[str]:
    value = body.get(key, [])
    if (
        not isinstance(value, list)
        or len(value) > MOST_SENSORS
        or not all(isinstance(each, str) for each in value)
    ):
        raise BadRequest(f"The {key} is a list of texts.")
    return value
