"""Makes, shows, opens, closes and deletes races."""

import secrets
import time
from dataclasses import dataclass, replace
from typing import Annotated

from drcli.base.errors import SettingsError, StorageError
from drcli.base.report import counted
from drcli.bucket.bucket import Bucket
from drcli.config.settings import Settings
from drcli.model import race_keys
from drcli.races.queue_lease import live_lease, runner_of
from drcli.races.race_options import RaceOptions, least_laps, rules_of, usual_average
from drcli.races.race_records import RaceRules
from drcli.races.race_report import RaceEntry, RaceList, RaceReport
from drcli.races.race_settings import check_track, settings_of_rules
from drcli.races.standings import date_text, moment, report_of
from drcli.races.stored_race import (
    RaceObjects,
    StoredRace,
    is_race_id,
    put,
    race_id,
    race_ids,
    read_race,
    read_rules,
)


@dataclass(frozen=True)
class DeletedRace:
    """A deleted race."""

    bucket: Annotated[str, "Where it was."]
    race: Annotated[str, "Its id."]
    objects: Annotated[int, "How many it had."]
    size_bytes: Annotated[int, "Their size."]
    dry_run: Annotated[bool, "Nothing was deleted."]

    def __str__(self) -> str:
        verb = "Would delete" if self.dry_run else "Deleted"
        size = f"{counted(self.objects, 'object')}, {self.size_bytes / 1e6:.1f} MB"
        return f"{verb} race {self.race} of s3://{self.bucket}: {size}."


def create_race(
    settings: Settings, bucket: Bucket, options: RaceOptions, *, now_s: float | None = None
) -> RaceReport:
    """Raises SettingsError for a wrong rule, a missing track, or an existing race."""
    now = time.time() if now_s is None else now_s
    rules = rules_of(settings, options, now)
    check_track(settings_of_rules(settings, rules))
    race = race_id(rules.name) or f"race-{secrets.token_hex(3)}"
    if bucket.list(race_keys.folder(race)):
        raise SettingsError(
            f"There is a race {race} in s3://{bucket.name} already.",
            remedy=f"Choose another name, or delete that race with `dr-race delete {race}`.",
        )
    put(bucket, race_keys.rules(race), rules)
    return show_race(bucket, race, now_s=now)


def show_race(bucket: Bucket, race: str, *, now_s: float | None = None) -> RaceReport:
    """Raises SettingsError without such a race."""
    now = time.time() if now_s is None else now_s
    runner = runner_of(bucket, race)  # before the results: what it finishes meanwhile is not lost
    return report_of(read_race(bucket, race), bucket.name, now, runner)


def list_races(
    bucket: Bucket, *, objects: RaceObjects | None = None, now_s: float | None = None
) -> RaceList:
    """The newest first; `objects` keeps what was read."""
    entries, damaged = [], []
    seen = (objects or RaceObjects()).look(bucket, race_keys.folder())
    for race in race_ids(seen):
        try:
            found = show_race(seen, race, now_s=now_s)
        except (SettingsError, StorageError) as error:
            damaged.append(str(error))
            continue
        first = found.leaderboard[0] if found.leaderboard else None
        leads = first is not None and first.rank == 1
        entries.append(
            RaceEntry(
                race=race,
                name=found.rules.name,
                state=found.state,
                world=found.rules.world,
                race_type=found.rules.race_type,
                submissions=len(found.submissions),
                queued=len(found.queue),
                leader=first.racer if first is not None and leads else None,
                leader_s=first.score_s if first is not None else None,
                leader_text=first.score_text if first is not None else "",
                runner=found.runner,
                created_at=moment(found.rules.created_at),
            )
        )
    entries.sort(key=lambda entry: (entry.created_at, entry.race), reverse=True)
    return RaceList(bucket.name, entries, damaged)


def close_race(bucket: Bucket, race: str, *, now_s: float | None = None) -> RaceReport:
    """Take no more submissions; those there are still driven.

    Raises:
        SettingsError: There is no such race, or it is closed.
    """
    now = time.time() if now_s is None else now_s
    rules = read_rules(bucket, race)
    if rules.closes_at is not None and rules.closes_at <= now:
        raise SettingsError(
            f"Race {race} was closed at {date_text(rules.closes_at)}.",
            remedy=f"Open it again with `dr-race open {race}`.",
        )
    changed = replace(rules, closes_at=now, changes=rules.changes + 1)
    put(bucket, race_keys.rules(race), changed)
    return show_race(bucket, race, now_s=now)


def open_race(
    bucket: Bucket, race: str, closes_at: float | None = None, *, now_s: float | None = None
) -> RaceReport:
    """Take submissions until a Unix time, or for ever.

    Raises:
        SettingsError: No such race, or the time is past.
    """
    now = time.time() if now_s is None else now_s
    rules = read_rules(bucket, race)
    if closes_at is not None and closes_at <= now:
        raise SettingsError(
            f"The race would close at {date_text(closes_at)}, which has passed.",
            remedy="Choose a later time with --closes.",
        )
    opens_at = None if rules.opens_at is None else min(rules.opens_at, now)
    changed = replace(rules, opens_at=opens_at, closes_at=closes_at, changes=rules.changes + 1)
    put(bucket, race_keys.rules(race), changed)
    return show_race(bucket, race, now_s=now)


def delete_race(bucket: Bucket, race: str, *, dry_run: bool = False) -> DeletedRace:
    """The racers' models stay.

    Raises:
        SettingsError: No such race, or its queue is being driven.
    """
    found = bucket.list(race_keys.folder(race)) if is_race_id(race) else []
    if not found:
        read_rules(bucket, race)
    holder = live_lease(bucket, race)
    if holder is not None:
        raise SettingsError(
            f"The queue of race {race} is being driven by {holder.owner}.",
            remedy=f"Stop it there with `dr-race stop {race}`.",
        )
    if not dry_run:
        rules = race_keys.rules(race)
        bucket.delete([rules])  # first: half a race is none
        bucket.delete([info.key for info in found if info.key != rules])
    size = sum(info.size_bytes for info in found)
    return DeletedRace(bucket.name, race, len(found), size, dry_run)


# Changes a race's rules before anybody has driven.


def options_of(rules: RaceRules) -> RaceOptions:
    """Without derived rules, and settings, which `change_rules` keeps."""
    average = usual_average(rules.max_laps)
    least = least_laps(rules.ranking, rules.max_laps, rules.average_laps)
    return RaceOptions(
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
    settings: Settings,
    bucket: Bucket,
    race: str,
    options: RaceOptions,
    *,
    now_s: float | None = None,
) -> RaceReport:
    """Give a race other rules, from `options_of`; its id stays.

    Raises:
        SettingsError: No such race, somebody has driven, or rules or submissions do not fit.
    """
    now = time.time() if now_s is None else now_s
    stored = read_race(bucket, race)
    _refuse_driven(stored)
    before = stored.rules
    new = rules_of(settings, options, now)
    # What was frozen stays, even if run.env is different now; other kinds need other objects.
    frozen = before.settings if new.race_type == before.race_type else new.settings
    rules = replace(
        new,
        created_at=before.created_at,
        settings={**frozen, **dict(options.settings)},
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


# The race that `dr-start-tournament` means without a name.


def only_tournament(bucket: Bucket) -> str:
    """Raises SettingsError for no or several unfinished races in pairs."""
    found = [
        entry.race
        for entry in list_races(bucket).races
        if entry.race_type == "HEAD_TO_MODEL" and entry.state != "finished"
    ]
    if len(found) == 1:
        return found[0]
    if found:
        raise SettingsError(
            f"s3://{bucket.name} has several races in pairs: {', '.join(found)}.",
            remedy=f"Name one of them, as in `dr-start-tournament {found[0]}`.",
        )
    raise SettingsError(
        f"s3://{bucket.name} has no race in pairs that is not finished.",
        remedy="Make one with `dr-race create NAME --type HEAD_TO_MODEL`, and submit models with "
        "`dr-race submit`.",
    )
