"""The WebSocket of the page, which says what topics it watches."""

import asyncio
import json
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from drcli.web.hub import Client, Hub
from drcli.web.topics import Message, text_message

MOST_CLIENTS = 64
LONGEST_REQUEST = 16_384
LONGEST_TOPIC = 200
SEND_S = 20.0
"""Then the page opens another connection."""

QUIET_S = 15.0
PAUSE_S = 0.05
TRAINING_PACE_S, EVALUATION_PACE_S = 0.25, 0.1
"""Between two looks at workers, whose news are sent together, so that a page draws them at once.

Cars of a training drive many times faster than real time: more pictures of them would jump, too.
"""
_TRY_LATER, _BAD_DATA = 1013, 1007
"""RFC 6455."""


class SocketRoute:
    """All WebSockets."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._open = 0

    async def serve(self, socket: WebSocket) -> None:
        if self._open >= MOST_CLIENTS:
            await socket.close(_TRY_LATER, "Too many pages are open.")
            return
        self._open += 1
        client = self._hub.connect()
        try:
            await socket.accept()
            async with asyncio.TaskGroup() as group:
                sender = group.create_task(self._send(socket, client))
                await self._receive(socket, client)
                sender.cancel()
        except* (WebSocketDisconnect, OSError, RuntimeError):
            pass  # the page was closed, or does not read
        finally:
            self._hub.disconnect(client)
            self._open -= 1

    async def _receive(self, socket: WebSocket, client: Client) -> None:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            topics = _topics_of(message.get("text"))
            if topics is None:
                await socket.close(_BAD_DATA, "The message is not one of the page.")
                return
            self._hub.watch(client, topics)
            await asyncio.sleep(PAUSE_S)

    async def _send(self, socket: WebSocket, client: Client) -> None:
        """OSError, or its subclass TimeoutError, if the page does not read."""
        looked = False
        while True:
            message: Message = _ALIVE
            with suppress(TimeoutError):
                async with asyncio.timeout(QUIET_S):
                    message = await self._hub.next_message(client)
            async with asyncio.timeout(SEND_S):
                if isinstance(message, bytes):
                    await socket.send_bytes(message)
                else:
                    await socket.send_text(message)
            looked = looked or _is_live(message)
            if looked and not client.news:
                await asyncio.sleep(_pace_s(client.topics))
                looked = False


_ALIVE = text_message("alive", None)
_LIVE = '{"topic":"live:'


def _is_live(message: Message) -> bool:
    return isinstance(message, bytes) or message.startswith(_LIVE)


def _pace_s(topics: Iterable[str]) -> float:
    evaluated = any(topic.startswith("live:") and ":evaluation" in topic for topic in topics)
    return EVALUATION_PACE_S if evaluated else TRAINING_PACE_S


def _topics_of(text: Any) -> set[str] | None:
    if not isinstance(text, str) or len(text) > LONGEST_REQUEST:
        return None
    try:
        topics = json.loads(text)["watch"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    if not isinstance(topics, list) or not all(
        isinstance(topic, str) and len(topic) <= LONGEST_TOPIC for topic in topics
    ):
        return None
    return set(topics)
