"""A race in the bucket.

Each object has one writer, so that all can work at once: racers write submissions, the organiser
rules and order, the queue results.
"""

import re
import secrets
import threading
import time
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeVar

from drcli.base.errors import SettingsError, StorageError, closest, shown
from drcli.base.json_record import JsonRecord
from drcli.bucket.bucket import (
    Bucket,
    Listing,
    ObjectDamaged,
    ObjectInfo,
    ObjectMissing,
    ObjectNewer,
    Watch,
    find_record,
)
from drcli.model import race_keys
from drcli.races.race_records import BracketDraw, QueueOrder, RaceResult, RaceRules, RaceSubmission

_NAME = re.compile(r"(\d{18})-([0-9a-f]{8})")
"""Microseconds of arrival, and id."""

_Record = TypeVar("_Record", bound=JsonRecord)


@dataclass(frozen=True)
class StoredRace:
    """Everything stored about a race.

    Attributes:
        submissions: In the order of arrival.
        orders: Of the organiser.
        results: By submission or pair.
        draw: Of a bracket; None before its first pair.
    """

    race: str
    rules: RaceRules
    submissions: Mapping[str, RaceSubmission]
    orders: Mapping[str, QueueOrder] = field(default_factory=dict)
    results: Mapping[str, RaceResult] = field(default_factory=dict)
    draw: BracketDraw | None = None
    damaged: list[str] = field(default_factory=list)

    def place(self, name: str) -> int:
        order = self.orders.get(name)
        return stamp_of(name) if order is None else order.place

    def restarts(self, *names: str) -> int:
        return sum(self.orders[name].restarts for name in names if name in self.orders)

    def result(self, *names: str) -> RaceResult | None:
        """None if restarted since."""
        found = self.results.get("_".join(sorted(names)))
        if found is None or found.restarts != self.restarts(*names):
            return None
        drove = {car.submission for car in found.cars}
        return found if found.state != "done" or drove == set(names) else None

    def find(self, text: str) -> str:
        """By id or its beginning.

        Raises:
            SettingsError: None, or several.
        """
        wanted = text.strip().lower()
        fitting = [
            name
            for name in self.submissions
            if wanted and (name == wanted or submission_id(name).startswith(wanted))
        ]
        if len(fitting) == 1:
            return fitting[0]
        known = ", ".join(map(submission_id, self.submissions)) or "none yet"
        what = "several submissions" if fitting else "no submission"
        raise SettingsError(
            f"Race {self.race} has {what} called {shown(text)}; there are: {known}.",
            remedy=f"List them with `dr-race show {self.race}`.",
        )


def submission_id(name: str) -> str:
    return name.rpartition("-")[2]


def stamp_of(name: str) -> int:
    found = _NAME.fullmatch(name)
    return int(found[1]) if found is not None else 0


def new_name(bucket: Bucket, race: str) -> str:
    """Sorts after all others, whatever the clocks say."""
    folder = race_keys.submission(race, "")[: -len(".json")]
    stamps = [stamp_of(_last(info.key)) for info in bucket.list(folder)]
    stamp = max([int(time.time() * 1e6), *(each + 1 for each in stamps)])
    return f"{stamp:018d}-{secrets.token_hex(4)}"


def is_race_id(text: str) -> bool:
    """Nothing else becomes part of a key."""
    return re.fullmatch(r"[a-z0-9-]{1,80}", text) is not None


def race_id(name: str) -> str:
    """Empty if nothing of the name can be kept."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "-", plain).strip("-")


def find_race(bucket: Bucket, text: str) -> str:
    """By id or name.

    Raises:
        SettingsError: There is no such race.
    """
    known = race_ids(bucket)
    words = " ".join(text.split())
    if words in known:
        return words
    for each in known:
        with suppress(StorageError):  # of another race
            if read_rules(bucket, each).name.casefold() == words.casefold():
                return each
    raise no_race(text, known, bucket.name)


def read_rules(bucket: Bucket, race: str) -> RaceRules:
    """Raises SettingsError without such a race, ObjectDamaged for unreadable rules."""
    if not is_race_id(race):
        raise no_race(race, race_ids(bucket), bucket.name)
    found = find_record(bucket, race_keys.rules(race), RaceRules.decode)
    if found is None:
        raise no_race(race, race_ids(bucket), bucket.name)
    return found


def read_race(bucket: Bucket, race: str) -> StoredRace:
    """Raises SettingsError without such a race, StorageError for a bucket that fails."""
    rules = read_rules(bucket, race)
    damaged: list[str] = []

    def read(key: str, decode: Callable[[bytes], _Record]) -> _Record | None:
        try:
            return find_record(bucket, key, decode)  # somebody may have withdrawn it since
        except (ObjectDamaged, ObjectNewer) as error:
            damaged.append(f"{error} {error.remedy}")
            return None

    def all_in(folder: str, decode: Callable[[bytes], _Record]) -> dict[str, _Record]:
        found = {}
        for info in bucket.list(race_keys.folder(race) + folder):
            name = _last(info.key)
            record = read(info.key, decode) if info.key.endswith(".json") else None
            if record is not None and all(map(_NAME.fullmatch, name.split("_"))):
                found[name] = record
        return found

    return StoredRace(
        race,
        rules,
        submissions=all_in("submissions/", RaceSubmission.decode),
        orders=all_in("order/", QueueOrder.decode),
        results=all_in("results/", RaceResult.decode),
        draw=read(race_keys.draw(race), BracketDraw.decode) if rules.in_pairs else None,
        damaged=damaged,
    )


def race_ids(bucket: Bucket) -> list[str]:
    found = (race_keys.race_of(info.key) for info in bucket.list(race_keys.folder()))
    return sorted(race for race in found if race is not None)


def no_race(race: str, known: list[str], bucket: str) -> SettingsError:
    likely = closest(race, known)
    hint = f"Did you mean {likely}? " if likely is not None else ""
    some = f"It has {', '.join(known[:8])}." if known else "It has no races."
    return SettingsError(
        f"There is no race {shown(race)} in s3://{bucket}. {some}",
        remedy=f"{hint}List races with `dr-race list`, or make one with `dr-race create NAME`.",
    )


def put(bucket: Bucket, key: str, record: JsonRecord) -> None:
    bucket.put(key, record.encode())


def _last(key: str) -> str:
    return key.rpartition("/")[2].removesuffix(".json")


# Reads records of races anew only when a listing shows a change.
#
# Pages look every second; without changes this costs one request.


_Version = tuple[str, int, datetime]


@dataclass(frozen=True)
class _Kept:
    """`version` was listed before reading, so it is never newer than the data."""

    version: _Version
    data: bytes
    age_s: float | None
    read_s: float


class RaceObjects:
    """Thread-safe memory of one bucket's races."""

    def __init__(self) -> None:
        self._kept: dict[str, _Kept] = {}
        self._lock = threading.Lock()

    def look(self, bucket: Bucket, folder: str) -> "SeenBucket":
        """The objects below a folder now, in a bucket that stays the same.

        Raises:
            StorageError: The bucket does not answer.
        """
        listed = {info.key: info for info in bucket.list(folder)}
        with self._lock:
            for key in [key for key in self._kept if key.startswith(folder)]:
                if key not in listed:
                    del self._kept[key]
        return SeenBucket(self, bucket, folder, listed)

    def kept(self, info: ObjectInfo) -> _Kept | None:
        with self._lock:
            found = self._kept.get(info.key)
        return found if found is not None and found.version == _version(info) else None

    def keep(self, info: ObjectInfo, data: bytes, age_s: float | None) -> None:
        with self._lock:
            self._kept[info.key] = _Kept(_version(info), data, age_s, time.monotonic())


class SeenBucket:
    """One look at a folder; a `Bucket` for reading."""

    def __init__(
        self, objects: RaceObjects, bucket: Bucket, folder: str, listed: dict[str, ObjectInfo]
    ) -> None:
        self.name = bucket.name
        self._objects, self._bucket = objects, bucket
        self._folder, self._listed = folder, listed
        self._given: set[str] = set()

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """From memory if unchanged.

        A second `get` in one look means damage, see `bucket.read_record`: then it is read anew.
        """
        found = self._known(key) if watch is None else None
        return self._read(key)[0] if found is None else found.data

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        found = self._known(key)
        if found is None:
            return self._read(key)
        passed_s = time.monotonic() - found.read_s
        return found.data, None if found.age_s is None else found.age_s + passed_s

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """This look does not show it."""
        self._bucket.put(key, data, watch=watch)

    def delete(self, keys: Iterable[str]) -> None:
        """This look still shows it."""
        self._bucket.delete(keys)

    def exists(self, key: str) -> bool:
        return key in self._listed if key.startswith(self._folder) else self._bucket.exists(key)

    def list(self, folder: str) -> Listing:
        if not folder.startswith(self._folder):
            return self._bucket.list(folder)
        return [info for key, info in self._listed.items() if key.startswith(folder)]

    def _known(self, key: str) -> _Kept | None:
        info = self._listed.get(key)
        if info is None:
            if key.startswith(self._folder):
                raise ObjectMissing(f"{self.name}/{key} does not exist.", remedy="Check the name.")
            return None
        if key in self._given:
            return None
        self._given.add(key)
        return self._objects.kept(info)

    def _read(self, key: str) -> tuple[bytes, float | None]:
        data, age_s = self._bucket.get_with_age(key)
        info = self._listed.get(key)
        if info is not None:
            self._objects.keep(info, data, age_s)
        return data, age_s


def _version(info: ObjectInfo) -> _Version:
    return info.etag, info.size_bytes, info.modified
