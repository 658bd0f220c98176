"""Topics of what workers show: `workers`, and `live:RUN:WORKER:VIEW`.

RUN is DR_RUN_ID, VIEW `camera`, `chase` (pictures), `scene` or `state` (JSON). A topic may be
watched before its worker runs. All pages look at one car of a worker: the last `POST /api/live/car`
with `run_id`, `worker` and `car` (null: the furthest) counts.
"""

import json
import re
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any

from pydantic import Field
from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.live.live_feed import WorkerKey
from drcli.live.live_record import LIVE_VIEWS, MOST_CAR, LiveMessage, LiveView
from drcli.records.run_record import RunRecord
from drcli.web.answers import BadRequest, Body, accepts
from drcli.web.hub import Publish
from drcli.web.live_words import LOST, scene_words, state_words
from drcli.web.served_folder import ServedFolder
from drcli.web.shared_feed import SharedFeed
from drcli.web.topics import Marker, Message, Picture, Snapshot, text_message

WORKERS_S = 1.0
WORKER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")

_TOPIC = re.compile(rf"live:(\d{{1,2}}):({WORKER_NAME.pattern}):({'|'.join(LIVE_VIEWS)})")


class LiveText:
    """A scene or a state, with its words; made only where somebody takes it."""

    def __init__(self, topic: str, worker: str, told: LiveMessage) -> None:
        self._topic, self._worker, self._told = topic, worker, told

    @cached_property
    def _text(self) -> str | None:
        told = self._told
        try:
            is_scene = told.view == "scene"
            words = scene_words(told.scene, self._worker) if is_scene else state_words(told.state)
            facts = {"step_s": told.step_s, "car": told.car, told.view: json.loads(told.data)}
            return text_message(self._topic, facts | {"words": words})
        except ValueError:
            return None  # damaged; the next one comes soon

    def message(self, since: Marker | None) -> tuple[Message | None, Marker]:
        return (None if since is self else self._text), self


class LiveViews:
    """Topics `live:…`."""

    def __init__(self, shared: SharedFeed) -> None:
        self._shared = shared
        self._part = shared.part(self._take, self._gone)
        self._open: dict[tuple[int, str, LiveView], tuple[str, Publish]] = {}

    def open(self, topic: str, publish: Publish) -> "_LiveSource":
        """ValueError if there is no such topic."""
        found = _TOPIC.fullmatch(topic)
        if found is None:
            raise ValueError(topic)
        view: Any = found[3]
        return _LiveSource(self, (int(found[1]), found[2], view), topic, publish)

    def begin(self, key: tuple[int, str, LiveView], topic: str, publish: Publish) -> None:
        self._open[key] = topic, publish
        self._ask(key[:2])

    def end(self, key: tuple[int, str, LiveView]) -> None:
        if self._open.pop(key, None) is not None:
            self._ask(key[:2])

    def _ask(self, worker: WorkerKey) -> None:
        self._part.watch(*worker, [view for run, name, view in self._open if (run, name) == worker])

    def _take(self, run_id: int, worker: str, message: LiveMessage) -> None:
        opened = self._open.get((run_id, worker, message.view))
        if opened is None:
            return
        topic, publish = opened
        if message.view in ("camera", "chase"):
            facts = {"step_s": message.step_s, "car": message.car}
            size = {"width": message.width, "height": message.height}
            publish(Picture(topic, message.data, facts | size))
            return
        publish(LiveText(topic, worker, message))

    def _gone(self, run_id: int, worker: str) -> None:
        opened = self._open.get((run_id, worker, "state"))
        if opened is not None:
            topic, publish = opened
            publish(Snapshot.of(topic, {"gone": True, "words": LOST}))


class _LiveSource:
    def __init__(
        self, views: LiveViews, key: tuple[int, str, LiveView], topic: str, publish: Publish
    ) -> None:
        self._views, self._key, self._topic, self._publish = views, key, topic, publish

    def start(self) -> None:
        self._views.begin(self._key, self._topic, self._publish)

    def stop(self) -> None:
        self._views.end(self._key)


def present(folder: ServedFolder) -> dict[str, Any]:
    runs = []
    for path in sorted((folder.directory / "data" / "runs").glob("*/run.json")):
        record = RunRecord.read(path.parent)
        if record is not None:
            state = record.state if record.alive or record.ended_at is not None else "lost"
            facts = {"prefix": record.prefix, "world": record.world, "state": state}
            runs.append({"run_id": record.run_id, **facts, "alive": record.alive})
    return {
        "runs": sorted(runs, key=lambda run: run["run_id"]),
        "workers": [
            {
                "run_id": worker.run_id,
                "worker": worker.worker,
                "car": folder.live.car(worker.run_id, worker.worker),
            }
            for worker in folder.live.workers()
        ],
    }


class ChosenCar(Body):
    run_id: Annotated[int, Field(ge=0, le=99)]
    worker: Annotated[str, Field(pattern=f"^{WORKER_NAME.pattern}$")]
    car: Annotated[int, Field(ge=0, lt=MOST_CAR)] | None = None


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """`POST /api/live/car`."""
    views = LiveViews(folder.live)

    folder.hub.poll("workers", WORKERS_S, lambda _: lambda: present(folder))
    folder.hub.add_kind("live", views.open)

    def choose(_: Request, body: ChosenCar) -> Any:
        run_id, worker = body.run_id, body.worker
        if not any((run_id, worker) == (w.run_id, w.worker) for w in folder.live.workers()):
            raise BadRequest(f"The worker {worker} of run {run_id} does not run now.", 404)
        folder.live.look_at(run_id, worker, body.car)
        return body.model_dump()

    return [Route("/api/live/car", accepts(choose), methods=["POST"])]
