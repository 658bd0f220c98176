"""Reads races once for all pages."""

import threading
from collections.abc import Callable
from typing import Any, TypeVar

from drcli.base.plain_json import keys_of, plain
from drcli.base.process_identity import this_machine
from drcli.config.bucket_config import StorageConfig
from drcli.config.settings import Settings
from drcli.exchange.evaluation_record import running_evaluations
from drcli.exchange.race_rules import RaceRules
from drcli.races import race_words
from drcli.races.organise import list_races
from drcli.races.queue_lease import live_lease
from drcli.races.race_limit import with_limit
from drcli.races.race_moments import moments_of
from drcli.races.race_report import RaceList, RaceReport
from drcli.races.race_runs import Runner
from drcli.races.race_settings import shown_settings
from drcli.races.standings import report_of
from drcli.races.stored_race import is_race_id, no_race, read_race
from drcli.races.unchanged_objects import RaceObjects
from drcli.store import race_keys
from drcli.store.bucket import Bucket
from drcli.store.connect import open_running_bucket
from drcli.web.served_folder import ServedFolder

T = TypeVar("T")


class RaceReader:
    """Shared."""

    def __init__(self, folder: ServedFolder, clock: Callable[[], float]) -> None:
        self.folder = folder
        self.clock = clock
        self._lock = threading.Lock()
        self._storage: StorageConfig | None = None
        self._objects = RaceObjects()

    def open(self) -> tuple[Settings, Bucket]:
        settings = self.folder.settings()
        return settings, self.folder.bucket(settings)

    def to_look_at(self, settings: Settings) -> Bucket | None:
        """Starts no server. None if there is none."""
        found = open_running_bucket(settings.storage)
        if found is None and settings.storage.cloud != "local":
            return self.folder.bucket(settings)
        return found

    def races(self) -> RaceList:
        settings = self.folder.settings()
        bucket = self.to_look_at(settings)
        if bucket is None:
            return RaceList(settings.bucket, [])
        return list_races(bucket, objects=self._objects_of(settings), now_s=self.clock())

    def report(self, race: str) -> RaceReport:
        """SettingsError if there is no such race."""
        return self._read(race)[0]

    def view(self, race: str) -> dict[str, Any]:
        report, more = self._read(race)
        return keys_of(report) | more

    def _read(self, race: str) -> tuple[RaceReport, dict[str, Any]]:
        settings = self.folder.settings()
        bucket = self.to_look_at(settings)
        if bucket is None or not is_race_id(race):
            raise no_race(race, [], settings.bucket)
        seen = self._objects_of(settings).look(bucket, race_keys.folder(race))
        if not seen.exists(race_keys.rules(race)):
            raise no_race(race, [], settings.bucket)
        lease = live_lease(seen, race)
        runner = Runner() if lease is None else Runner(lease.session, lease.owner)
        stored = read_race(seen, race)
        report = report_of(stored, bucket.name, self.clock(), runner)
        report = with_limit(report, settings.tracks_folder, self.folder.directory)
        more = {
            "words": words_of(report),
            "settings": shown_settings(stored.rules),
            "moments": plain(moments_of(stored, runner)),
            "drawn": stored.draw is not None,
            "changeable": not stored.results and stored.draw is None,
            "here": lease is not None and not lease.newer and lease.machine == this_machine(),
            "live": self._live(race),
        }
        return report, more

    def _live(self, race: str) -> dict[str, Any] | None:
        """The evaluation of this race on this machine, as live topics name it."""
        start = f"{race_keys.folder(race)}models/"
        for record in running_evaluations(self.folder.directory):
            if record.prefix.startswith(start):
                return {"run_id": record.run_id, "worker": f"evaluation-{record.stamp}"}
        return None

    def _objects_of(self, settings: Settings) -> RaceObjects:
        with self._lock:
            if settings.storage != self._storage:
                self._storage, self._objects = settings.storage, RaceObjects()
            return self._objects


def words_of(report: RaceReport) -> dict[str, str]:
    """The terminal's sentences about a race."""
    return {
        "place": race_words.place(report),
        "standing": race_words.standing(report),
        **words_of_rules(report.rules),
    }


def words_of_rules(rules: RaceRules) -> dict[str, str]:
    return {
        "kind": race_words.kind(rules),
        "decides": race_words.decides(rules),
        "penalties": race_words.penalties(rules),
        "conditions": race_words.conditions(rules),
    }
