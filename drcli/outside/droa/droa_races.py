"""Races of DeepRacer on AWS: which there are, and submissions to them.

Source: aws-solutions/deepracer-on-aws, operations ListLeaderboards, CreateSubmission and
ListSubmissions.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any

from drcli.base.clock import Waiting
from drcli.base.errors import SettingsError, StorageError, shown
from drcli.base.report import Col, View, bold, counted, second, table
from drcli.outside.droa.droa_api import Droa, RemoteModel, text_at, value_at
from drcli.outside.web_request import polls

POLL_S = 15.0
PATIENCE_S = 3600.0
"""A submission waits until those before it have been driven, up to 20 minutes each."""

OVER = ("COMPLETED", "FAILED", "CANCELED")


@dataclass(frozen=True)
class RemoteRace:
    """A race, which DeepRacer on AWS calls a leaderboard."""

    race_id: Annotated[str, "Id of the race.", Col("race id")]
    name: Annotated[str, "Its name.", Col("name", side="left")]
    race_type: Annotated[str, "TIME_TRIAL or OBJECT_AVOIDANCE.", Col("type")]
    track: Annotated[str, "Its track, with the direction.", Col("track", side="left")]
    is_open: Annotated[
        bool,
        "Whether it takes submissions now.",
        Col("open", lambda is_open: "yes" if is_open else "no"),
    ]
    closes_at: Annotated[
        str,
        "When it stops taking them, ISO 8601; the event itself for a live race.",
        Col("closes", second),
    ]
    most_submissions: Annotated[int, "How often each racer may submit.", Col("submissions each")]
    is_live: Annotated[bool, "Whether somebody starts each submission by hand."]


@dataclass(frozen=True)
class RemoteRaces:
    """The races of a site."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    races: Annotated[list[RemoteRace], "Those that are open first, then by name."]

    def view(self) -> View:
        none = f"There is no race at {self.site}."
        return [bold(self.site), table(self.races)] if self.races else [none]


@dataclass(frozen=True)
class DroaSubmission:
    """A submission to a race."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    race: Annotated[str, "Name of the race."]
    model: Annotated[str, "Name of the model."]
    number: Annotated[int, "Which submission of yours it is; 0 if nobody waited."]
    status: Annotated[str, "QUEUED, IN_PROGRESS, COMPLETED, FAILED or CANCELED."]
    score_s: Annotated[float | None, "What counts in the race, in seconds; None without one."]
    best_lap_s: Annotated[float | None, "Its best lap, in seconds; None without one."]
    laps: Annotated[int, "How many laps it completed."]
    resets: Annotated[int, "How often the car was put back."]

    def __str__(self) -> str:
        began = f"Submitted {self.model} to {self.race}"
        if self.score_s is None:
            which = f" (submission {self.number})" if self.number else ""
            return f"{began}{which}: {self.status}."
        lap = "" if self.best_lap_s is None else f", best lap {self.best_lap_s:.3f} s"
        return (
            f"{began} (submission {self.number}): {self.score_s:.3f} s{lap}, "
            f"{counted(self.laps, 'lap')}, {counted(self.resets, 'reset')}."
        )


def list_races(droa: Droa, now: datetime | None = None) -> RemoteRaces:
    races = [_race(values, now or datetime.now(UTC)) for values in droa.leaderboards()]
    return RemoteRaces(droa.place, sorted(races, key=lambda race: (not race.is_open, race.name)))


def find_race(droa: Droa, wanted: str) -> RemoteRace:
    """By id or name.

    Raises:
        SettingsError: There is not exactly one.
    """
    races = list_races(droa).races
    found = [race for race in races if race.race_id == wanted] or [
        race for race in races if race.name == wanted
    ]
    if len(found) != 1:
        ids = ", ".join(race.race_id for race in found)
        raise SettingsError(
            f"Several races at {droa.place} are called {shown(wanted)}: {ids}."
            if found
            else f"There is no race {shown(wanted)} at {droa.place}.",
            remedy="`dr-droa races` lists the races with their ids.",
        )
    return found[0]


def refuse_closed(droa: Droa, race: RemoteRace) -> None:
    """Raises SettingsError unless the race takes submissions now."""
    if not race.is_open:
        verb = "closed" if _is_past(race.closes_at, datetime.now(UTC)) else "closes"
        raise SettingsError(
            f"The race {race.name} at {droa.place} takes no submissions now; it {verb} at "
            f"{second(race.closes_at)} UTC.",
            remedy="`dr-droa races` shows which races are open.",
        )


def submit(
    droa: Droa, race: RemoteRace, model: RemoteModel, waiting: Waiting | None
) -> DroaSubmission:
    """Submit a model; `waiting` None: do not wait until it was driven.

    Raises:
        SettingsError: The model cannot be submitted now, or the racer has no submissions left.
        StorageError: A call failed, or it took too long.
    """
    before = max((number for number, _ in _own(droa, race)), default=0)
    if before >= race.most_submissions:
        raise SettingsError(
            f"You have submitted {before} times to the race {race.name}, as often as it allows.",
            remedy="Choose another race: `dr-droa races` lists them.",
        )
    if model.status != "READY":
        raise SettingsError(
            f"The model {model.name} has the status {model.status}, so it cannot be submitted.",
            remedy=f"Wait until `dr-droa show {model.model_id}` says READY.",
        )
    droa.submit(race.race_id, model.model_id)
    if waiting is None or race.is_live:
        return _report(droa, race, model, 0, {"status": "QUEUED"})
    with waiting(f"{droa.place} lets {model.name} drive in {race.name} ..."):
        for _ in polls(POLL_S, PATIENCE_S, droa.pause):
            for number, values in _own(droa, race):
                mine = number > before and text_at(values, "modelId") == model.model_id
                if mine and text_at(values, "status") in OVER:
                    return _report(droa, race, model, number, values)
    raise StorageError(
        f"{droa.place} has not driven {model.name} in {race.name} after "
        f"{PATIENCE_S / 60:g} minutes.",
        remedy="Look at the race in the browser; the submission stays in its queue.",
    )


def _own(droa: Droa, race: RemoteRace) -> list[tuple[int, Mapping[str, Any]]]:
    return [
        (_whole(values, "submissionNumber"), values) for values in droa.submissions(race.race_id)
    ]


def _report(
    droa: Droa, race: RemoteRace, model: RemoteModel, number: int, values: Mapping[str, Any]
) -> DroaSubmission:
    return DroaSubmission(
        droa.place,
        race.name,
        model.name,
        number,
        text_at(values, "status"),
        _seconds(values, "rankingScore"),
        _seconds(values, "stats", "bestLapTime"),
        _whole(values, "stats", "completedLapCount"),
        _whole(values, "stats", "resetCount"),
    )


def _race(values: Mapping[str, Any], now: datetime) -> RemoteRace:
    is_live = values.get("isLive") is True
    closes = text_at(values, "liveEventTime" if is_live else "closeTime")
    if is_live:
        is_open = text_at(values, "liveEventStatus") != "COMPLETED" and (
            values.get("submissionPeriodOpen") is True or not _is_past(closes, now)
        )
    else:
        is_open = _is_past(text_at(values, "openTime"), now) and not _is_past(closes, now)
    direction = text_at(values, "trackConfig", "trackDirection").casefold().replace("_", "-")
    return RemoteRace(
        race_id=text_at(values, "leaderboardId"),
        name=text_at(values, "name"),
        race_type=text_at(values, "raceType"),
        track=f"{text_at(values, 'trackConfig', 'trackId')} {direction}".strip(),
        is_open=is_open,
        closes_at=closes,
        most_submissions=_whole(values, "maxSubmissionsPerUser"),
        is_live=is_live,
    )


def _is_past(text: str, now: datetime) -> bool:
    try:
        return datetime.fromisoformat(text) <= now
    except (ValueError, TypeError):
        return False


def _whole(values: Mapping[str, Any], *path: str) -> int:
    value = value_at(values, *path)
    return value if isinstance(value, int) else 0


def _seconds(values: Mapping[str, Any], *path: str) -> float | None:
    """From milliseconds, as the interface has them."""
    value = value_at(values, *path)
    return value / 1000 if isinstance(value, int | float) and value else None
