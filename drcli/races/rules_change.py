"""Changes a race's rules before anybody has driven."""

import time
from dataclasses import replace

from drcli.base.errors import SettingsError
from drcli.config.settings import Settings
from drcli.exchange.race_rules import RaceRules
from drcli.races.organise import show_race
from drcli.races.race_report import RaceReport
from drcli.races.race_settings import check_track, settings_of_rules
from drcli.races.race_wish import RaceWish, least_laps, rules_of, usual_average
from drcli.races.stored_race import StoredRace, put, read_race
from drcli.store import race_keys
from drcli.store.bucket import Bucket


def wish_of(rules: RaceRules) -> RaceWish:
    """Without derived rules, and settings, which `change_rules` keeps."""
    average = usual_average(rules.max_laps)
    least = least_laps(rules.ranking, rules.max_laps, rules.average_laps)
    return RaceWish(
        name=rules.name,
        world=rules.world,
        reverse=rules.reverse,
        race_type=rules.race_type,
        ranking=rules.ranking,
        max_laps=rules.max_laps,
        min_laps=None if rules.min_laps == least else rules.min_laps,
        average_laps=None if rules.average_laps == average else rules.average_laps,
        off_track_penalty_s=rules.off_track_penalty_s,
        collision_penalty_s=rules.collision_penalty_s,
        max_submissions=rules.max_submissions,
        opens_at=rules.opens_at,
        closes_at=rules.closes_at,
        seed=rules.seed,
        pairing=rules.pairing,
        sensors=tuple(rules.sensors),
    )


def change_rules(
    settings: Settings, bucket: Bucket, race: str, wish: RaceWish, *, now_s: float | None = None
) -> RaceReport:
    """Give a race other rules, from `wish_of`; its id stays.

    Raises:
        SettingsError: No such race, somebody has driven, or rules or submissions do not fit.
    """
    now = time.time() if now_s is None else now_s
    stored = read_race(bucket, race)
    _refuse_driven(stored)
    before = stored.rules
    new = rules_of(settings, wish, now)
    # What was frozen stays, even if run.env is different now; other kinds need other objects.
    frozen = before.settings if new.race_type == before.race_type else new.settings
    rules = replace(
        new,
        created_at=before.created_at,
        settings={**frozen, **dict(wish.settings)},
        changes=before.changes + 1,
    )
    check_track(settings_of_rules(settings, rules))
    if stored.submissions and rules.sensors and set(rules.sensors) != set(before.sensors):
        raise SettingsError(
            f"Race {race} has submissions, so the allowed sensors cannot be restricted.",
            remedy="Withdraw the submissions, or leave the sensors as they are.",
        )
    put(bucket, race_keys.rules(race), rules)
    return show_race(bucket, race, now_s=now)


def _refuse_driven(stored: StoredRace) -> None:
    if stored.results or stored.draw is not None:
        raise SettingsError(
            f"Race {stored.race} is being driven or has results, so its rules are fixed.",
            remedy="Make another race with `dr-race create NAME`; `dr-race open` and `dr-race "
            "close` still say until when it takes submissions.",
        )
