"""One connection to each live worker for everything in the console that shows it.

Workers are asked for the union of what is looked at, whoever looks, so five pages cost a worker as
much as one.
"""

import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol

from drcli.exchange.live_record import LiveMessage, LiveView
from drcli.runs.live_feed import LiveFeed, LiveWorker, OnMessage, WorkerKey

OnGone = Callable[[int, str], None]


class Feed(Protocol):
    """What is needed of `LiveFeed`."""

    def watch(
        self, run_id: int, worker: str, views: Iterable[LiveView], car: int | None = None
    ) -> None:
        """Say what to watch."""

    def workers(self) -> list[LiveWorker]:
        """The workers that can be watched."""

    def close(self) -> None:
        """End all connections."""


OpenFeed = Callable[[Path, OnMessage, OnGone], Feed]


class SharedFeed:
    """The live workers of a working folder. Any thread may use it.

    Args:
        directory: The working folder.
        open_feed: Makes the feed, for the first look; it stays until `close`, and costs nothing
            while nobody watches.
    """

    def __init__(self, directory: Path, open_feed: OpenFeed = LiveFeed) -> None:
        self._directory, self._open_feed = directory, open_feed
        self._feed: Feed | None = None
        self._lock = threading.Lock()
        self._parts: list[FeedPart] = []
        self._cars: dict[WorkerKey, int] = {}

    def part(
        self, on_message: OnMessage, on_gone: OnGone = lambda run_id, worker: None
    ) -> "FeedPart":
        """A share of the feed for one purpose, with wishes of its own.

        Args:
            on_message: Gets what any part watches, in a thread of the feed; see `LiveFeed`.
            on_gone: Called when the connection to a worker has ended.
        """
        part = FeedPart(self, on_message, on_gone)
        with self._lock:
            self._parts.append(part)
        return part

    def workers(self) -> list[LiveWorker]:
        """The workers that can be watched now, by run and name."""
        return self._opened().workers()

    def car(self, run_id: int, worker: str) -> int | None:
        """The car that was chosen; None for the one that has come furthest."""
        return self._cars.get((run_id, worker))

    def look_at(self, run_id: int, worker: str, car: int | None) -> None:
        """Choose the car of a worker that all who look see; the last choice counts."""
        with self._lock:
            if car is None:
                self._cars.pop((run_id, worker), None)
            else:
                self._cars[run_id, worker] = car
        self.ask((run_id, worker))

    def ask(self, key: WorkerKey) -> None:
        """Tell the feed what is wanted of a worker by all parts together."""
        # In one block: a wish must not overtake a later one. `watch` only sends some bytes.
        feed = self._opened()
        with self._lock:
            views = {view for part in self._parts for view in part.wanted(key)}
            feed.watch(*key, sorted(views), self._cars.get(key))

    def remove(self, part: "FeedPart") -> None:
        """Forget a part and its wishes."""
        with self._lock:
            if part not in self._parts:
                return
            self._parts.remove(part)
        for key in part.watched():
            self.ask(key)

    def close(self) -> None:
        """End all connections."""
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
    """A share of a `SharedFeed`, used like a `LiveFeed`."""

    def __init__(self, shared: SharedFeed, on_message: OnMessage, on_gone: OnGone) -> None:
        self.on_message, self.on_gone = on_message, on_gone
        self._shared = shared
        self._wanted: dict[WorkerKey, frozenset[LiveView]] = {}

    def watch(
        self, run_id: int, worker: str, views: Iterable[LiveView], car: int | None = None
    ) -> None:
        """Say what this part watches of a worker from now on; nothing, if there is no view.

        Args:
            run_id: DR_RUN_ID.
            worker: Its name.
            views: What to show.
            car: Not None to choose the car for all who look at the worker.
        """
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
        """What this part watches of a worker."""
        return self._wanted.get(key, frozenset())

    def watched(self) -> list[WorkerKey]:
        """The workers that it watches."""
        return list(self._wanted)

    def close(self) -> None:
        """Watch nothing any more."""
        self._shared.remove(self)
