"""Distributes the values of topics to the clients of the WebSocket.

A topic has a source only while somebody watches it. A client keeps a set of topics with news, not a
queue: a slow reader misses values and never delays others.
"""

import asyncio
import re
from collections.abc import Callable, Set
from dataclasses import dataclass, field
from typing import Any, Protocol

from drcli.base.installation import lazy_imports
from drcli.web.topics import Marker, Message, Snapshot, Value, text_message

with lazy_imports():
    from drcli.web import answers

MOST_TOPICS = 64
_UNKNOWN = {
    "message": "There is no such topic, or this page watches too many.",
    "remedy": "Load the page again.",
    "code": 2,
}


class Source(Protocol):
    """Of a topic."""

    def start(self) -> None:
        """Called in the event loop."""

    def stop(self) -> None:
        """No value is published after it."""


Publish = Callable[[Value], None]
"""Any thread may call it."""

Read = Callable[[], Any]
"""A `Value`, or plain data for a `Snapshot`; None: nothing new."""

OpenSource = Callable[[str, Publish], Source]
"""ValueError: there is no such topic."""


@dataclass(eq=False)
class Client:
    """One connection.

    Attributes:
        news: Topics with a value that it may not have, the longest waiting first, so that one that
            always changes does not hold up others.
        markers: What it has got of each topic.
        replies: Messages for it alone.
    """

    topics: set[str] = field(default_factory=set)
    news: dict[str, None] = field(default_factory=dict)
    markers: dict[str, Marker] = field(default_factory=dict)
    replies: list[str] = field(default_factory=list)
    wake: asyncio.Event = field(default_factory=asyncio.Event)

    def tell(self, topic: str) -> None:
        self.news.setdefault(topic)
        self.wake.set()


class Hub:
    """Runs in the event loop, except `publish`."""

    def __init__(self) -> None:
        self._kinds: dict[str, OpenSource] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._sources: dict[str, Source] = {}
        self._values: dict[str, Value] = {}
        self._clients: set[Client] = set()

    def add_kind(self, kind: str, open_source: OpenSource) -> None:
        """Declare topics that are `kind`, or begin with it and a colon."""
        self._kinds[kind] = open_source

    def poll(self, pattern: str, period_s: float, reader: Callable[..., Read]) -> None:
        """Declare topics that are read again and again.

        `reader` gets the topic and the groups of the pattern, and raises ValueError if there is no
        such topic.
        """

        def open_polled(topic: str, publish: Publish) -> Polled:
            found = re.fullmatch(pattern, topic, re.ASCII)
            if found is None:
                raise ValueError(topic)
            return Polled(topic, publish, reader(topic, *found.groups()), period_s)

        kind = re.match(r"\w+", pattern)
        assert kind is not None
        self.add_kind(kind[0], open_polled)

    def run_in(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    @property
    def watched(self) -> Set[str]:
        return self._sources.keys()

    def publish(self, topic: str, value: Value) -> None:
        """Any thread may call it."""
        loop = self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._accept, topic, value)

    def connect(self) -> Client:
        client = Client()
        self._clients.add(client)
        return client

    def disconnect(self, client: Client) -> None:
        self.watch(client, set())
        self._clients.discard(client)

    def watch(self, client: Client, topics: set[str]) -> None:
        """Replace what a client watches, and tell it which topics are wrong or too many."""
        refused = []
        wanted = sorted(topics)
        for topic in client.topics - set(wanted[:MOST_TOPICS]):
            client.topics.discard(topic)
            client.news.pop(topic, None)
            client.markers.pop(topic, None)
            self._close_unwatched(topic)
        for topic in wanted[:MOST_TOPICS]:
            if topic in client.topics:
                continue
            if not self._open(topic):
                refused.append(topic)
                continue
            client.topics.add(topic)
            if topic in self._values:
                client.tell(topic)
        refused += wanted[MOST_TOPICS:][:MOST_TOPICS]
        client.replies = [text_message(topic, {"error": _UNKNOWN}) for topic in refused]
        if refused:
            client.wake.set()

    async def next_message(self, client: Client) -> Message:
        while True:
            if client.replies:
                return client.replies.pop()
            while client.news:
                topic = next(iter(client.news))
                del client.news[topic]
                value = self._values.get(topic)
                if value is None:
                    continue
                message, marker = value.message(client.markers.get(topic))
                client.markers[topic] = marker
                if message is not None:
                    return message
            client.wake.clear()
            await client.wake.wait()

    def close(self) -> None:
        for source in self._sources.values():
            source.stop()
        self._sources.clear()

    def _open(self, topic: str) -> bool:
        if topic in self._sources:
            return True
        open_source = self._kinds.get(topic.partition(":")[0])
        if open_source is None:
            return False
        try:
            source = open_source(topic, lambda value: self.publish(topic, value))
        except ValueError:
            return False
        self._sources[topic] = source
        source.start()
        return True

    def _close_unwatched(self, topic: str) -> None:
        if any(topic in client.topics for client in self._clients):
            return
        source = self._sources.pop(topic, None)
        if source is not None:
            source.stop()
        self._values.pop(topic, None)

    def _accept(self, topic: str, value: Value) -> None:
        if topic not in self._sources:
            return  # nobody watches any more
        self._values[topic] = value
        for client in self._clients:
            if topic in client.topics:
                client.tell(topic)


class Stored:
    """For values that something else publishes."""

    def __init__(self, publish: Publish, newest: Callable[[], Value]) -> None:
        self._publish, self._newest = publish, newest

    def start(self) -> None:
        self._publish(self._newest())

    def stop(self) -> None:
        """Nothing."""


class Polled:
    """Reads in a thread, and publishes what it finds, errors as `{"error": …}`."""

    def __init__(self, topic: str, publish: Publish, read: Read, period_s: float) -> None:
        self._topic, self._publish, self._read = topic, publish, read
        self._period_s = period_s
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        self._task = asyncio.get_running_loop().create_task(self._poll())

    def stop(self) -> None:
        """A reading under way ends; its value is dropped."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    async def _poll(self) -> None:
        while True:
            try:
                value = await asyncio.to_thread(self._read)
            except Exception as error:
                value = answers.error_of(error)
            if value is not None:
                is_value = hasattr(value, "message")
                self._publish(value if is_value else Snapshot.of(self._topic, value))
            await asyncio.sleep(self._period_s)
