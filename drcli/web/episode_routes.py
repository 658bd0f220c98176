"""Answers of the episode player about stored episodes."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from drcli.base.errors import StorageError
from drcli.base.json_record import plain
from drcli.bucket.bucket import ObjectDamaged, ObjectInfo, ObjectMissing, read_record
from drcli.model import keys
from drcli.model.growing_file import combined_metrics
from drcli.model.history import HistoryReader
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_history
from drcli.records.episode_metrics import EpisodeMetrics, decode_metrics
from drcli.run.seen_in_bucket import SeenRun, distant_run, read_lap_lines, seen_run
from drcli.view.playback.player_handle import PlayerHandle, facts_of
from drcli.view.playback.stored_traces import models_with_traces, parse_name, stored_traces
from drcli.web.answers import BadRequest, answers
from drcli.web.episode_words import trace_text, trace_title
from drcli.web.hub import Read
from drcli.web.live_words import distant_words, lines_text
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Rows, Snapshot, Value

PACKED = "application/octet-stream"
_NUMBER_LIMIT = 10**9


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """The first request starts the player's process."""
    player = PlayerHandle(folder.directory)
    folder.at_end.append(player.close)

    def models(_: Request) -> Any:
        settings = folder.settings()
        listed = folder.bucket(settings).list("")
        return {"own": settings.model_prefix, "models": models_with_traces(listed)}

    def traces(request: Request) -> Any:
        settings = folder.settings()
        bucket = folder.bucket(settings)
        found = stored_traces(ModelStore(bucket, _text(request, "model")), settings.model)
        named = [plain(trace) | {"text": trace_text(trace)} for trace in found.traces]
        return plain(found) | {"traces": named}

    def opened(request: Request) -> Any:
        facts = facts_of(asked("open")(request))
        trace = parse_name(_text(request, "trace"))
        return facts | {"title": "" if trace is None else trace_title(trace)}

    def asked(do: str, *names: str) -> Callable[[Request], bytes]:
        def ask(request: Request) -> bytes:
            numbers = {name: _number(request, name) for name in names}
            return player.ask({"do": do, **_names(request), **numbers})

        return ask

    def as_json(ask: Callable[[Request], bytes]) -> Callable[[Request], Any]:
        return lambda request: facts_of(ask(request))

    def as_packed(ask: Callable[[Request], bytes]) -> Callable[[Request], Response]:
        return lambda request: Response(ask(request), media_type=PACKED)

    steps = ("episode", "first", "count")
    answered = {
        "models": models,
        "traces": traces,
        "open": opened,
        "lap": as_json(asked("lap", "episode")),
        "steps": as_packed(asked("steps", *steps)),
        "policy": as_json(asked("policy", *steps, "checkpoint")),
        "explained": as_packed(asked("explain", *steps, "checkpoint")),
    }
    return [Route(f"/api/play/{name}", answers(each)) for name, each in answered.items()]


def _names(request: Request) -> dict[str, str]:
    return {name: _text(request, name) for name in ("model", "trace")}


def _text(request: Request, name: str) -> str:
    value = request.query_params.get(name, "")
    if not value or len(value) > 1024:
        raise BadRequest(f"The request needs a {name}.")
    return value


def _number(request: Request, name: str) -> int:
    text = request.query_params.get(name, "")
    if not (text.isascii() and text.isdecimal() and len(text) < 12):
        raise BadRequest(f"The request needs a number {name}.")
    number = int(text)
    if number > _NUMBER_LIMIT:
        raise BadRequest(f"The number {name} is too large.")
    return number


# Reads a training's episodes again and again, but only changed objects.


_METRICS = re.compile(r"(TrainingMetrics(?:_\d+)?\.json)(\.part-\d+)?")


class DrivenEpisode(NamedTuple):
    """An episode; `evaluation` is 1 or 0, `progress` percent."""

    iteration: int
    evaluation: int
    reward: float
    progress: float


class MetricsReader:
    def __init__(self) -> None:
        self._known: dict[str, tuple[ObjectInfo, list[EpisodeMetrics]]] = {}
        self._episodes: list[DrivenEpisode] = []

    def read(self, model: ModelStore) -> list[DrivenEpisode]:
        """By iteration; the same list if nothing has changed.

        Without damaged objects and without episodes of version 0.1.0, whose iteration is unknown.

        Raises:
            StorageError: The bucket does not answer.
        """
        folder = keys.folder(model.metrics_prefix)
        infos = {
            info.key: info
            for info in model.bucket.list(folder)
            if _METRICS.fullmatch(info.key.removeprefix(folder))
        }
        kept = {key: found for key, found in self._known.items() if found[0] == infos.get(key)}
        if kept.keys() == infos.keys() == self._known.keys():
            return self._episodes
        self._known = kept
        # A part comes before its whole object: a part that is deleted meanwhile is in that.
        for key in sorted(infos, reverse=True):
            if key not in kept:
                with suppress(ObjectMissing, ObjectDamaged):
                    records = read_record(model.bucket, key, decode_metrics)
                    kept[key] = infos[key], records
        self._episodes = _sorted(kept, folder)
        return self._episodes


def _sorted(
    known: dict[str, tuple[ObjectInfo, list[EpisodeMetrics]]], folder: str
) -> list[DrivenEpisode]:
    files: dict[str, tuple[list[EpisodeMetrics], list[list[EpisodeMetrics]]]] = {}
    for key in sorted(known):
        found = _METRICS.fullmatch(key.removeprefix(folder))
        assert found is not None
        whole, parts = files.setdefault(found[1], ([], []))
        if found[2]:
            parts.append(known[key][1])
        else:
            whole.extend(known[key][1])
    records = [
        record for whole, parts in files.values() for record in combined_metrics(whole, parts)
    ]
    numbered = [
        (record.iteration, record.phase == "evaluation", record.episode, record)
        for record in records
        if record.iteration is not None
    ]
    numbered.sort(key=lambda each: each[:3])
    return [
        DrivenEpisode(iteration, int(evaluation), record.reward_score, record.completion_percentage)
        for iteration, evaluation, _, record in numbered
    ]


# Topics of what was driven, from the bucket.
#
# `episodes:RUN` has a row for each episode, `laps:RUN:WORKER` the lines of a worker's last
# iteration, `elsewhere:RUN` who trains the model on another machine. RUN is DR_RUN_ID, WORKER a
# number.


EPISODES_S = 2.0
LAPS_S = 2.0

ELSEWHERE_S = 4.0


def _away(run: SeenRun) -> StorageError:
    return StorageError(
        f"The bucket of {run.prefix} is away: its server does not run.",
        remedy="It starts with the next training or `dr-list-models`; this page goes on by itself.",
    )


class EpisodeRows:
    """Of a run."""

    def __init__(self, topic: str, look: Callable[[], SeenRun]) -> None:
        self._look = look
        self._reader = MetricsReader()
        self._rows = Rows(topic)

    def read(self) -> Value:
        """Rows of iteration, 1 for an evaluation, reward, progress."""
        run = self._look()
        if run.model is None:
            raise _away(run)
        self._rows.update(self._reader.read(run.model))
        return self._rows


class LapReader:
    """After each iteration."""

    def __init__(self, topic: str, look: Callable[[], SeenRun], worker: int) -> None:
        self._topic, self._look, self._worker = topic, look, worker
        self._history = HistoryReader()
        self._read: tuple[str, int] | None = None

    def read(self) -> Value | None:
        """None if they were read before."""
        run = self._look()
        if run.model is None:
            self._read = None
            raise _away(run)
        history, _ = readable_history(run.model, self._history)
        newest = history[-1].iteration if history else -1
        if self._read == (run.prefix, newest):
            return None
        lines = []
        if newest >= 0:
            lines = read_lap_lines(ModelStore(run.model.bucket, run.prefix), newest, self._worker)
        self._read = run.prefix, newest
        iteration = newest if newest >= 0 else None
        found = {"iteration": iteration, "lines": lines, "text": lines_text(iteration)}
        return Snapshot.of(self._topic, found)


def topics(folder: ServedFolder) -> Sequence[BaseRoute]:
    def look_at(run: str) -> Callable[[], SeenRun]:
        return lambda: seen_run(folder.settings(), int(run))

    def laps(topic: str, run: str, worker: str) -> Read:
        return LapReader(topic, look_at(run), int(worker)).read

    def elsewhere(topic: str, run: str) -> Read:
        def read() -> Snapshot:
            found = distant_run(look_at(run)())
            return Snapshot.of(topic, plain(found) | distant_words(found))

        return read

    poll, number = folder.hub.poll, r"(\d{1,2})"
    poll(f"episodes:{number}", EPISODES_S, lambda topic, run: EpisodeRows(topic, look_at(run)).read)
    poll(rf"laps:{number}:(\d{{1,3}})", LAPS_S, laps)
    poll(f"elsewhere:{number}", ELSEWHERE_S, elsewhere)
    return []
