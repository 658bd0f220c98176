"""The WebSocket of the page, as good and bad pages use it."""

import asyncio
import contextlib
import json

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from starlette.websockets import WebSocketDisconnect

from drcli.web import socket_route
from drcli.web.hub import Hub, Stored
from drcli.web.socket_route import LONGEST_REQUEST, SocketRoute
from drcli.web.topics import Snapshot

WS = "ws://127.0.0.1:8100/ws"


def next_of(opened, topic):
    while True:
        message = json.loads(opened.receive_text())
        if message["topic"] == topic:
            return message["data"]


def test_a_page_gets_what_it_watches(client):
    with client.websocket_connect(WS) as opened:
        opened.send_text(json.dumps({"watch": ["run", "machine", "tasks"]}))
        assert next_of(opened, "run")["state"] == "none"
        opened.send_text(json.dumps({"watch": ["tasks"]}))
        opened.send_text(json.dumps({"watch": ["machine", "tasks"]}))
        assert next_of(opened, "machine")["cores"] >= 1


def test_a_topic_that_does_not_exist_is_answered(client):
    with client.websocket_connect(WS) as opened:
        opened.send_text(json.dumps({"watch": ["nothing", "run:abc", "run:-1", "run:100"]}))
        for topic in ("run:abc", "nothing", "run:-1", "run:100"):
            assert "no such topic" in next_of(opened, topic)["error"]["message"]
            opened.send_text(json.dumps({"watch": [topic, "nothing", "run:-1", "run:100"]}))


BAD = [
    "",
    "{",
    "[]",
    "null",
    "1",
    '"watch"',
    "{}",
    '{"watch": null}',
    '{"watch": "run"}',
    '{"watch": {"run": 1}}',
    '{"watch": [1]}',
    '{"watch": [null]}',
    '{"watch": [["run"]]}',
    '{"unwatch": ["run"]}',
    "[" * 16_000,
    '{"watch": ["' + "a" * 201 + '"]}',
    '{"watch": [' + " " * LONGEST_REQUEST + "]}",
    "\x00",
    "\ud7ff\ue000",
]


@pytest.mark.parametrize("message", BAD)
def test_a_message_that_no_page_sends_ends_the_connection(client, message):
    with client.websocket_connect(WS) as opened:
        opened.send_text(message)
        with pytest.raises(WebSocketDisconnect) as ended:
            opened.receive_text()

    assert ended.value.code == 1007


def test_bytes_end_the_connection(client):
    with client.websocket_connect(WS) as opened:
        opened.send_bytes(b"\x00\x01")
        with pytest.raises(WebSocketDisconnect) as ended:
            opened.receive_text()

    assert ended.value.code == 1007


@pytest.mark.parametrize(
    "topic",
    [
        "",
        ":",
        "run:",
        "run:\x00",
        "run:../../etc/passwd",
        "run:1e3",
        "run:１",
        "\u202erun",
        "a" * 200,
    ],
)
def test_strange_topics_do_no_harm(client, topic):
    with client.websocket_connect(WS) as opened:
        opened.send_text(json.dumps({"watch": [topic, "tasks"]}))
        assert next_of(opened, "tasks") == {"tasks": []}


def test_too_many_pages_are_refused_and_the_others_go_on(client, monkeypatch):
    monkeypatch.setattr(socket_route, "MOST_CLIENTS", 3)
    with contextlib.ExitStack() as pages:
        opened = [pages.enter_context(client.websocket_connect(WS)) for _ in range(3)]
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(WS):
            pass
        opened[0].send_text(json.dumps({"watch": ["tasks"]}))
        assert next_of(opened[0], "tasks") == {"tasks": []}
    with client.websocket_connect(WS) as again:
        again.send_text(json.dumps({"watch": ["tasks"]}))
        assert next_of(again, "tasks") == {"tasks": []}


def test_a_quiet_connection_gives_signs_of_life(client, monkeypatch):
    monkeypatch.setattr(socket_route, "QUIET_S", 0.01)
    with client.websocket_connect(WS) as opened:
        assert next_of(opened, "alive") is None
        opened.send_text(json.dumps({"watch": ["tasks"]}))
        assert next_of(opened, "tasks") == {"tasks": []}
        assert next_of(opened, "alive") is None


class Noted:
    """A WebSocket that notes what it is sent."""

    def __init__(self):
        self.sent = asyncio.Queue()

    async def send_text(self, text):
        message = json.loads(text)
        await self.sent.put((message["topic"].rpartition(":")[2], message["data"]))


@pytest.mark.parametrize(
    ("worker", "pace"), [("sim-0", "TRAINING"), ("evaluation-1", "EVALUATION")]
)
def test_what_workers_show_is_sent_together_and_the_newest_only(monkeypatch, worker, pace):
    for each in ("TRAINING", "EVALUATION"):
        monkeypatch.setattr(socket_route, f"{each}_PACE_S", 0.3 if each == pace else 1e6)
    camera, scene = topics = [f"live:0:{worker}:{view}" for view in ("camera", "scene")]

    async def look():
        hub, noted = Hub(), Noted()
        hub.run_in(asyncio.get_running_loop())
        hub.add_kind(
            "live", lambda topic, publish: Stored(publish, lambda: Snapshot.of(topic, "first"))
        )
        client = hub.connect()
        hub.watch(client, set(topics))
        sending = asyncio.create_task(SocketRoute(hub)._send(noted, client))
        first = [await noted.sent.get() for _ in topics]
        for topic, value in ((camera, "older"), (scene, "new"), (camera, "new")):
            hub.publish(topic, Snapshot.of(topic, value))
        second = [await noted.sent.get() for _ in topics]
        sending.cancel()
        return first, second

    first, second = asyncio.run(look())

    assert sorted(first) == [("camera", "first"), ("scene", "first")]
    assert sorted(second) == [("camera", "new"), ("scene", "new")]


KINDS = ("run", "machine", "tasks", "model", "models", "races", "race", "log", "live", "episode")

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters()),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)

TOPICS = st.builds(
    lambda kind, rest: f"{kind}:{rest}", st.sampled_from(KINDS), st.text(st.characters())
)


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(watched=JSON | st.lists(TOPICS, max_size=4))
@example(watched=["run:\ud800"])
@example(watched=["log:../../etc/passwd", "live:\x00", "model:/", "race:.."])
def test_no_message_of_any_shape_is_a_fault_of_the_server(client, watched):
    with contextlib.suppress(WebSocketDisconnect), client.websocket_connect(WS) as opened:
        opened.send_text(json.dumps({"watch": watched}))
        opened.send_text("the end")  # is refused after the first one is done
        while True:
            assert "fault in the program" not in opened.receive_text()
    with client.websocket_connect(WS) as opened:
        opened.send_text(json.dumps({"watch": ["tasks"]}))
        assert "tasks" in next_of(opened, "tasks")
