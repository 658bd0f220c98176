"""Pictures of a worker as MJPEG at `/stream`, for scripts written for DeepRacer-for-Cloud.

Its viewer's parameters: topic, quality, width and height; `worker` chooses another. A stream stays
open while no worker runs.
"""

import asyncio
import io
import threading
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route
from starlette.types import Receive, Scope, Send

from drcli.base.installation import lazy_imports
from drcli.config.settings import Settings
from drcli.live.live_record import LiveMessage, LiveView
from drcli.web.answers import BadRequest, error_of, status_of
from drcli.web.listen import STREAM, TOPICS, USUAL_TOPIC
from drcli.web.served_folder import ServedFolder

with lazy_imports():
    from PIL import Image

MOST_STREAMS = 8
REPEAT_S = 0.2
"""After so long without a newer picture, the last one is sent a second time."""
BOUNDARY = "picture"

LIMITS: Mapping[str, tuple[int, int]] = {
    "width": (16, 1920),
    "height": (16, 1080),
    "quality": (1, 95),
    "worker": (0, 999),
}
USUAL_QUALITY = 75


class Feed(Protocol):
    """See `LiveFeed`."""

    def watch(
        self, run_id: int, worker: str, views: Sequence[LiveView], car: int | None = None
    ) -> None:
        """See there."""

    def close(self) -> None:
        """See there."""


Key = tuple[int, str, LiveView]


@dataclass(frozen=True)
class Wanted:
    """None: the size of the worker."""

    key: Key
    width: int | None = None
    height: int | None = None
    quality: int | None = None

    @staticmethod
    def of(query: Mapping[str, str], run_id: int) -> "Wanted":
        topic = query.get("topic", USUAL_TOPIC)
        view = TOPICS.get(topic)
        if view is None:
            known = ", ".join(TOPICS)
            raise BadRequest(f"There is no topic {topic[:200]}; there are {known}.", 404)
        worker = _number(query, "worker")
        return Wanted(
            (run_id, f"sim-{worker or 0}", view),
            _number(query, "width"),
            _number(query, "height"),
            _number(query, "quality"),
        )

    def draw(self, message: LiveMessage) -> bytes:
        size = (self.width or message.width, self.height or message.height)
        if self.quality is None and size == (message.width, message.height):
            return message.data

        with Image.open(io.BytesIO(message.data)) as picture:
            scaled = picture.convert("RGB").resize(size)
        file = io.BytesIO()
        scaled.save(file, "JPEG", quality=self.quality or USUAL_QUALITY)
        return file.getvalue()


def _number(query: Mapping[str, str], name: str) -> int | None:
    text = query.get(name, "")
    if not text:
        return None
    least, greatest = LIMITS[name]
    if not (text.isascii() and text.isdecimal() and len(text) < 9):
        raise BadRequest(f"{name} is a whole number from {least} to {greatest}.")
    if not least <= int(text) <= greatest:
        raise BadRequest(f"{name}={text} is not from {least} to {greatest}.")
    return int(text)


@dataclass(eq=False)
class _Stream:
    key: Key
    newest: LiveMessage | None = None
    wake: asyncio.Event = field(default_factory=asyncio.Event)


class Streams:
    """The feed ends with the last one."""

    def __init__(self, open_feed: Callable[[Callable[[int, str, LiveMessage], None]], Feed]):
        self._open_feed = open_feed
        self._feed: Feed | None = None
        self._streams: set[_Stream] = set()
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self, key: Key) -> _Stream:
        """BadRequest if there are too many."""
        if len(self._streams) >= MOST_STREAMS:
            raise BadRequest(f"{MOST_STREAMS} streams are open already; close one.", 503)
        self._loop = asyncio.get_running_loop()
        stream = _Stream(key)
        self._streams.add(stream)
        if self._feed is None:
            self._feed = self._open_feed(self._take)
        self._ask(key)
        return stream

    def close(self, stream: _Stream) -> None:
        self._streams.discard(stream)
        if self._feed is None:
            return
        self._ask(stream.key)
        if not self._streams:
            # It waits for its threads.
            threading.Thread(target=self._feed.close, daemon=True).start()
            self._feed = None

    async def pictures(self, stream: _Stream, wanted: Wanted) -> AsyncIterator[bytes]:
        """The newest picture whenever the last one has been taken.

        In a pause the last one follows once more: browsers built on Chromium show a picture only
        when the next one begins.
        """
        part = b""
        while True:
            try:
                async with asyncio.timeout(REPEAT_S if part else None):
                    await stream.wake.wait()
            except TimeoutError:
                yield part
                part = b""
                continue
            stream.wake.clear()
            if stream.newest is None:
                continue
            step_s = stream.newest.step_s
            try:
                jpeg = await asyncio.to_thread(wanted.draw, stream.newest)
            except (OSError, ValueError):
                continue  # a damaged picture; the next one comes soon
            head = (
                f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\n"
                f"Content-Length: {len(jpeg)}\r\nX-Timestamp: {step_s:.3f}\r\n\r\n"
            )
            part = head.encode() + jpeg + b"\r\n"
            yield part

    def _ask(self, key: Key) -> None:
        assert self._feed is not None, "streams are open"
        run_id, worker, _ = key
        views = sorted({each.key[2] for each in self._streams if each.key[:2] == key[:2]})
        self._feed.watch(run_id, worker, views)

    def _take(self, run_id: int, worker: str, message: LiveMessage) -> None:
        loop = self._loop
        if message.view in ("camera", "chase") and loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._give, (run_id, worker, message.view), message)

    def _give(self, key: Key, message: LiveMessage) -> None:
        for stream in self._streams:
            if stream.key == key:
                stream.newest = message
                stream.wake.set()


class _Answer(StreamingResponse):
    def __init__(self, streams: Streams, stream: _Stream, wanted: Wanted) -> None:
        media_type = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        super().__init__(streams.pictures(stream, wanted), media_type=media_type)
        self._streams, self._stream = streams, stream

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._streams.close(self._stream)


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """`GET /stream`."""
    streams = Streams(folder.live.part)

    async def stream(request: Request) -> Response:
        try:
            settings: Settings = await asyncio.to_thread(folder.settings)
            wanted = Wanted.of(request.query_params, settings.run_id)
            opened = streams.open(wanted.key)
        except Exception as error:
            body: dict[str, Any] = error_of(error)
            return JSONResponse(body, status_of(error))
        return _Answer(streams, opened, wanted)

    return [Route(STREAM, stream, methods=["GET"])]
