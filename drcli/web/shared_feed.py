"""One connection to each live worker for everything in the console.

Workers are asked for the union of what is looked at, so five pages cost as much as one.
"""

import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol

from drcli.live.live_feed import LiveFeed, LiveWorker, OnMessage, WorkerKey
from drcli.live.live_record import LiveMessage, LiveView

OnGone = Callable[[int, str], None]


class Feed(Protocol):
    """See `LiveFeed`."""

    def watch(
        self, run_id: int, worker: str, views: Iterable[LiveView], car: int | None = None
    ) -> None:
        """See there."""

    def workers(self) -> list[LiveWorker]:
        """See there."""

    def close(self) -> None:
        """See there."""


OpenFeed = Callable[[Path, OnMessage, OnGone], Feed]


class SharedFeed:
    """The live workers of a folder; thread-safe."""

    def __init__(self, directory: Path, open_feed: OpenFeed = LiveFeed) -> None:
        self._directory, self._open_feed = directory, open_feed
        self._feed: Feed | None = None
        self._lock = threading.Lock()
        self._parts: list[FeedPart] = []
        self._cars: dict[WorkerKey, int] = {}

    def part(
        self, on_message: OnMessage, on_gone: OnGone = lambda run_id, worker: None
    ) -> "FeedPart":
        """A share of the feed for one purpose.

        Args:
            on_message: Gets what any part watches, in a thread of the feed.
            on_gone: Called when a worker's connection has ended.
        """
        part = FeedPart(self, on_message, on_gone)
        with self._lock:
            self._parts.append(part)
        return part

    def workers(self) -> list[LiveWorker]:
        return self._opened().workers()

    def car(self, run_id: int, worker: str) -> int | None:
        """None for the one that has come furthest."""
        return self._cars.get((run_id, worker))

    def look_at(self, run_id: int, worker: str, car: int | None) -> None:
        with self._lock:
            if car is None:
                self._cars.pop((run_id, worker), None)
            else:
                self._cars[run_id, worker] = car
        self.ask((run_id, worker))

    def ask(self, key: WorkerKey) -> None:
        # In one block: a request must not overtake a later one. `watch` only sends some bytes.
        feed = self._opened()
        with self._lock:
            views = {view for part in self._parts for view in part.wanted(key)}
            feed.watch(*key, sorted(views), self._cars.get(key))

    def remove(self, part: "FeedPart") -> None:
        with self._lock:
            if part not in self._parts:
                return
            self._parts.remove(part)
        for key in part.watched():
            self.ask(key)

    def close(self) -> None:
        with self._lock:
            feed, self._feed = self._feed, None
            self._parts.clear()
        if feed is not None:
            feed.close()

    def _opened(self) -> Feed:
        with self._lock:
            if self._feed is None:
                self._feed = self._open_feed(self._directory, self._message, self._gone)
            return self._feed

    def _message(self, run_id: int, worker: str, message: LiveMessage) -> None:
        for part in list(self._parts):
            part.on_message(run_id, worker, message)

    def _gone(self, run_id: int, worker: str) -> None:
        for part in list(self._parts):
            part.on_gone(run_id, worker)


class FeedPart:
    """Used like a `LiveFeed`."""

    def __init__(self, shared: SharedFeed, on_message: OnMessage, on_gone: OnGone) -> None:
        self.on_message, self.on_gone = on_message, on_gone
        self._shared = shared
        self._wanted: dict[WorkerKey, frozenset[LiveView]] = {}

    def watch(
        self, run_id: int, worker: str, views: Iterable[LiveView], car: int | None = None
    ) -> None:
        """Replace what it watches of a worker; `car` is chosen for all who look."""
        key, wanted = (run_id, worker), frozenset(views)
        if wanted:
            self._wanted[key] = wanted
        else:
            self._wanted.pop(key, None)
        if car is not None:
            self._shared.look_at(run_id, worker, car)
        else:
            self._shared.ask(key)

    def wanted(self, key: WorkerKey) -> frozenset[LiveView]:
        """Its views."""
        return self._wanted.get(key, frozenset())

    def watched(self) -> list[WorkerKey]:
        return list(self._wanted)

    def close(self) -> None:
        self._shared.remove(self)
