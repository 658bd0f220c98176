"""Reads races once for all pages."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from starlette.requests import Request

from drcli.base.errors import SettingsError
from drcli.base.json_record import keys_of, plain
from drcli.base.processes import this_machine
from drcli.base.report import counted
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_running_bucket
from drcli.config.run_config import StorageConfig
from drcli.config.settings import Settings
from drcli.model import race_keys
from drcli.races import race_words
from drcli.races import race_words as words
from drcli.races.lap_ranking import figures_of
from drcli.races.organise import list_races
from drcli.races.queue_lease import live_lease
from drcli.races.race_records import RaceResult, RaceRules
from drcli.races.race_report import (
    LeaderboardRow,
    RaceList,
    RaceReport,
    SubmissionEntry,
    with_limit,
)
from drcli.races.race_settings import shown_settings
from drcli.races.standings import Runner, report_of, run_state
from drcli.races.stored_race import (
    RaceObjects,
    StoredRace,
    is_race_id,
    no_race,
    race_ids,
    read_race,
    submission_id,
)
from drcli.records.run_record import running_evaluations
from drcli.web.answers import BadRequest
from drcli.web.page_words import in_page
from drcli.web.race_fields import KINDS
from drcli.web.served_folder import ServedFolder

# What a race drives now, and drove last.


@dataclass(frozen=True)
class RunCar:
    """Times are simulated seconds; `clean` laps have no reset or penalty."""

    submission: str
    racer: str
    model: str
    complete: int = 0
    laps: int = 0
    best_lap_s: float | None = None
    total_s: float | None = None
    clean: int = 0
    text: str = ""


@dataclass(frozen=True)
class RaceRun:
    """A submission or pair; `key` is unique, state running, done or failed."""

    key: str
    state: str
    began_at: float
    ended_at: float | None
    cars: list[RunCar] = field(default_factory=list)
    message: str = ""


@dataclass(frozen=True)
class RaceMoments:
    driving: RaceRun | None
    last: RaceRun | None


def moments_of(stored: StoredRace, runner: Runner) -> RaceMoments:
    driving: RaceRun | None = None
    last: RaceRun | None = None
    for name in sorted(stored.results):
        names = name.split("_")
        result = stored.result(*names)
        if result is None or not all(each in stored.submissions for each in names):
            continue
        state = run_state(result, runner)
        if state == "running":
            driving = _run(stored, names, result, state)
        elif state in ("done", "failed") and (
            last is None or (result.ended_at or 0.0) > (last.ended_at or 0.0)
        ):
            last = _run(stored, names, result, state)
    return RaceMoments(driving, last)


def _run(stored: StoredRace, names: list[str], result: RaceResult, state: str) -> RaceRun:
    laps = {car.submission: car.laps for car in result.cars}
    cars = []
    for name in [car.submission for car in result.cars] or names:
        submission, driven = stored.submissions[name], laps.get(name, [])
        times = [lap.lap_s for lap in driven if lap.complete]
        figures = figures_of(driven, 1)
        cars.append(
            RunCar(
                submission_id(name),
                submission.racer,
                submission.model,
                len(times),
                len(driven),
                min(times, default=None),
                sum(times) if times else None,
                figures.clean,
                f"{words.laps_of(figures)}, best {words.time_of(figures.best)}"
                if times
                else words.laps_of(figures),
            )
        )
    return RaceRun(
        f"{'+'.join(map(submission_id, names))}-{result.restarts}-{result.session}",
        state,
        result.began_at,
        result.ended_at,
        cars,
        result.message,
    )


BADGES = {
    "scheduled": ("Not open yet", "warn"),
    "open": ("Open", "good"),
    "closed": ("Closed", "warn"),
    "finished": ("Finished", ""),
}


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

    def bucket(self) -> Bucket:
        """If its server runs; SettingsError else."""
        settings = self.folder.settings()
        found = open_running_bucket(settings.storage)
        if found is None:
            raise SettingsError(
                f"There is no bucket {settings.bucket} yet.",
                remedy="Train a model, or import one, and make a race.",
            )
        return found

    def races(self) -> dict[str, Any]:
        settings = self.folder.settings()
        bucket, found = open_running_bucket(settings.storage), RaceList(settings.bucket, [])
        if bucket is not None:
            found = list_races(bucket, objects=self._objects_of(settings), now_s=self.clock())
        races = [
            plain(each) | {"kind": KINDS.get(each.race_type, ""), "badge": BADGES[each.state]}
            for each in found.races
        ]
        return keys_of(found) | {"races": races}

    def report(self, race: str) -> RaceReport:
        """SettingsError if there is no such race."""
        return self._read(race)[0]

    def view(self, race: str) -> dict[str, Any]:
        report, more = self._read(race)
        return keys_of(report) | more

    def _read(self, race: str) -> tuple[RaceReport, dict[str, Any]]:
        settings = self.folder.settings()
        bucket = open_running_bucket(settings.storage)
        if bucket is None:
            raise no_race(race, [], settings.bucket)
        if not is_race_id(race):
            raise no_race(race, race_ids(bucket), settings.bucket)
        seen = self._objects_of(settings).look(bucket, race_keys.folder(race))
        if not seen.exists(race_keys.rules(race)):
            raise no_race(race, race_ids(bucket), settings.bucket)
        lease = live_lease(seen, race)
        runner = Runner() if lease is None else Runner(lease.session, lease.owner)
        stored = read_race(seen, race)
        report = report_of(stored, bucket.name, self.clock(), runner)
        report = with_limit(report, settings.tracks_folder, self.folder.directory)
        moments = moments_of(stored, runner)
        racers = {each.submission: each.racer for each in report.submissions}
        more = {
            "words": words_of(report),
            "badge": BADGES[report.state],
            "settings": shown_settings(stored.rules),
            "leaderboard": [
                plain(row) | words_of_row(row, report.rules) for row in report.leaderboard
            ],
            "submissions": [_entry(each) for each in report.submissions],
            "pairs": list(_pairs(report)),
            "next": [
                " – ".join(racers.get(each, each) for each in run.split("+"))
                for run in report.queue
            ],
            "moments": plain(moments),
            "films": films_of(report, moments.last),
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


def race_of(request: Request) -> str:
    race = request.path_params["race"]
    if not is_race_id(race):
        raise BadRequest("This is not the id of a race.", 404)
    return str(race)


def films_of(report: RaceReport, run: RaceRun | None) -> list[str]:
    """Keys of the videos of a run that has ended."""
    names = [car.submission for car in run.cars] if run is not None and run.state == "done" else []
    if len(names) == 1:
        own = (each.video for each in report.submissions if each.submission == names[0])
        return [video for video in own if video]
    pairs = (pair.videos for pair in report.pairs if {pair.first, pair.second} == set(names))
    return next(pairs, [])


def words_of_row(row: LeaderboardRow, rules: RaceRules) -> dict[str, str]:
    """What decides about a row of the leaderboard, and how far it is behind."""
    if rules.in_pairs:
        points = f"{row.points or 0:g}"
        result = f"{points} point{'s' * (row.points != 1)}"
        return {"points_text": points, "result": result, "gap": f"best lap {row.best_lap_text}"}
    result = row.laps_text if row.score_s is None else row.score_text
    return {"result": result, "gap": "not qualified" if row.rank is None else row.gap()}


def _facts(report: RaceReport) -> Iterator[str]:
    """Times are those of this machine."""
    rules, takes = report.rules, report.state in ("open", "scheduled")
    if rules.opens_at:
        yield f"Opens {_moment(rules.opens_at)}."
    if rules.closes_at:
        yield f"{'Closes' if takes else 'Closed'} {_moment(rules.closes_at)}."
    if rules.max_submissions:
        yield f"Each racer has {counted(rules.max_submissions, 'submission')}."
    if rules.sensors:
        yield f"Sensors: {', '.join(rules.sensors)}."
    if settings := race_words.conditions(rules):
        yield f"Settings: {settings}."
    if report.runner:
        yield f"The queue is driven by {report.runner}."


def _moment(unix_s: float) -> str:
    return f"{datetime.fromtimestamp(unix_s):%d %b %Y, %H:%M}"


ENTRY_STATES = {
    "queued": "waits",
    "running": "is driven now",
    "done": "was driven",
    "over the limit": "does not count: the racer has more submissions than the rules allow",
}


def _entry(entry: SubmissionEntry) -> dict[str, Any]:
    """With its laps, or what became of it."""
    said = "; ".join(entry.lap_text) or ENTRY_STATES.get(entry.state, entry.state)
    failure = f": {entry.message} {entry.remedy}" if entry.message else ""
    shown: dict[str, Any] = plain(entry) | {"said": in_page(f"{said}{failure}")}
    return shown


_PAIR_STATES = {
    "waiting": "waits for earlier pairs",
    "queued": "in the queue",
    "running": "driven now",
    "alone": "goes on without racing",
}
_LAST_ROUNDS = ("Final", "Semi-finals", "Quarter-finals")


def _pairs(report: RaceReport) -> Iterator[dict[str, Any]]:
    """With their states in words, and the names of their rounds."""
    last = max((pair.round for pair in report.pairs), default=0)
    for pair in report.pairs:
        said = _PAIR_STATES.get(pair.state, "" if pair.winner else "Nobody wins.")
        if pair.state == "failed":
            said = in_page(f"failed: {pair.message} {pair.remedy}")
        name, later = f"Round {pair.round}", last - pair.round
        if report.rules.pairing == "bracket" and later < len(_LAST_ROUNDS):
            name = _LAST_ROUNDS[later]
        yield plain(pair) | {"said": said, "round_name": name}


def waiting_text(report: RaceReport) -> str:
    count = len(report.queue)
    return f"{counted(count, 'run')} {'waits' if count == 1 else 'wait'}"


def _idle(report: RaceReport) -> str:
    if report.state == "finished":
        return "The race is over."
    if not report.queue:
        return "Nobody is driving."
    if report.runner:
        return "The next car goes to the start."
    return f"{waiting_text(report)}. Nobody is driving the queue."


def words_of(report: RaceReport) -> dict[str, str]:
    """The terminal's sentences about a race."""
    return {
        "place": report.place(),
        "standing": report.standing(),
        "idle": _idle(report),
        "facts": " ".join(_facts(report)),
        **words_of_rules(report.rules),
    }


def words_of_rules(rules: RaceRules) -> dict[str, str]:
    return {
        "kind": race_words.kind(rules),
        "decides": race_words.decides(rules),
        "penalties": race_words.penalties(rules),
        "conditions": race_words.conditions(rules),
    }
