"""What watchers of topics get, and what topics cost that nobody watches."""

import asyncio
import json
import threading

import pytest

from drcli.base.errors import StorageError
from drcli.web.hub import MOST_TOPICS, Hub, Polled, Stored
from drcli.web.topics import Snapshot


class Source:
    """Notes whether it was started and stopped."""

    def __init__(self, topic, publish, log):
        self.topic, self.publish, self.log = topic, publish, log

    def start(self):
        self.log.append(f"start {self.topic}")

    def stop(self):
        self.log.append(f"stop {self.topic}")


class World:
    """A hub with topics `a`, `a:1`, ... whose sources note what happens."""

    def __init__(self):
        self.log, self.sources = [], {}
        self.hub = Hub()
        self.hub.run_in(asyncio.get_running_loop())
        self.hub.add_kind("a", self.open)

    def open(self, topic, publish):
        if topic == "a:none":
            raise ValueError(topic)
        self.sources[topic] = Source(topic, publish, self.log)
        return self.sources[topic]

    async def publish(self, topic, value):
        self.hub.publish(topic, Snapshot.of(topic, value))
        await asyncio.sleep(0)

    async def next(self, client):
        message = json.loads(await asyncio.wait_for(self.hub.next_message(client), 20))
        return message["topic"], message["data"]

    def has_news(self, client):
        return bool(client.news or client.replies)


def in_loop(scenario):
    """Run a scenario in an event loop."""

    async def run():
        await scenario(World())

    return lambda: asyncio.run(run())


@in_loop
async def _lifetime(world):
    first, second = world.hub.connect(), world.hub.connect()
    await world.publish("a", 1)
    assert (world.log, set(world.hub.watched)) == ([], set())
    world.hub.watch(first, {"a"})
    world.hub.watch(second, {"a"})
    assert world.log == ["start a"]
    world.hub.watch(first, set())
    assert world.log == ["start a"]
    world.hub.disconnect(second)
    assert world.log == ["start a", "stop a"]
    assert not world.hub.watched


def test_a_source_runs_while_somebody_watches_and_only_then():
    _lifetime()


@in_loop
async def _values(world):
    client = world.hub.connect()
    world.hub.watch(client, {"a"})
    await world.publish("a", 1)
    assert await world.next(client) == ("a", 1)
    await world.publish("a", 1)
    await world.publish("a", 2)
    assert await world.next(client) == ("a", 2)
    late = world.hub.connect()
    world.hub.watch(late, {"a"})
    assert await world.next(late) == ("a", 2)
    world.hub.watch(client, set())
    await world.publish("a", 3)
    assert not world.has_news(client)


def test_watchers_get_what_is_new_and_a_late_one_gets_the_newest():
    _values()


@in_loop
async def _old(world):
    client = world.hub.connect()
    world.hub.watch(client, {"a"})
    await world.publish("a", "old")
    world.hub.watch(client, set())
    world.hub.watch(client, {"a"})
    assert not world.has_news(client)
    await world.publish("a", "new")
    assert await world.next(client) == ("a", "new")


def test_nobody_gets_a_value_from_before_the_source_ended():
    _old()


@in_loop
async def _slow(world):
    slow, quick = world.hub.connect(), world.hub.connect()
    for client in (slow, quick):
        world.hub.watch(client, {"a:1", "a:2"})
    for number in range(1000):
        await world.publish("a:1", number)
        assert await world.next(quick) == ("a:1", number)
    await world.publish("a:2", "seldom")
    assert len(slow.news) == 2
    assert await world.next(slow) == ("a:1", 999)
    assert await world.next(slow) == ("a:2", "seldom")
    assert not world.has_news(slow)


def test_a_slow_reader_misses_what_is_old_and_delays_nobody():
    _slow()


@in_loop
async def _fair(world):
    client = world.hub.connect()
    world.hub.watch(client, {"a:1", "a:2"})
    await world.publish("a:1", 0)
    await world.publish("a:2", 0)
    order = []
    for number in range(1, 5):
        order.append((await world.next(client))[0])
        await world.publish(order[-1], number)
    assert order == ["a:1", "a:2", "a:1", "a:2"]


def test_a_topic_that_changes_all_the_time_does_not_hide_others():
    _fair()


@in_loop
async def _unknown(world):
    client = world.hub.connect()
    world.hub.watch(client, {"b", "a:none", "a:good"})
    refused = dict([await world.next(client), await world.next(client)])
    assert refused.keys() == {"b", "a:none"}
    assert "no such topic" in refused["b"]["error"]["message"]
    assert client.topics == {"a:good"}


def test_topics_that_do_not_exist_are_answered_and_the_others_are_watched():
    _unknown()


@in_loop
async def _many(world):
    client = world.hub.connect()
    world.hub.watch(client, {f"a:{k:04}" for k in range(1000)})
    assert len(client.topics) == MOST_TOPICS
    assert 0 < len(client.replies) <= MOST_TOPICS
    world.hub.watch(client, {f"a:{k}" for k in range(MOST_TOPICS)})
    assert len(client.topics) == MOST_TOPICS
    assert not client.replies
    world.hub.disconnect(client)
    assert not world.hub.watched


def test_nobody_watches_more_topics_than_are_allowed():
    _many()


@in_loop
async def _threads(world):
    client = world.hub.connect()
    world.hub.watch(client, {"a"})
    threads = [
        threading.Thread(target=world.sources["a"].publish, args=(Snapshot.of("a", k),))
        for k in range(8)
    ]
    for thread in threads:
        thread.start()
    topic, value = await world.next(client)
    assert topic == "a"
    assert value in range(8)
    for thread in threads:
        thread.join()


def test_any_thread_may_publish():
    _threads()


def test_publishing_after_the_end_of_the_server_does_nothing():
    hub = Hub()
    hub.publish("a", Snapshot.of("a", 1))

    async def run():
        hub.run_in(asyncio.get_running_loop())

    asyncio.run(run())
    hub.publish("a", Snapshot.of("a", 1))
    assert not hub.watched


@in_loop
async def _polled(world):
    answers = iter([{"n": 1}, StorageError("The bucket is away.", remedy="Start it."), {"n": 2}])
    reads = []

    def read():
        reads.append(threading.current_thread())
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return Snapshot.of("p", answer)

    world.hub.add_kind("p", lambda topic, publish: Polled(topic, publish, read, 0.0))
    client = world.hub.connect()
    world.hub.watch(client, {"p"})
    assert await world.next(client) == ("p", {"n": 1})
    error = (await world.next(client))[1]["error"]
    assert (error["message"], error["remedy"], error["code"]) == (
        "The bucket is away.",
        "Start it.",
        4,
    )
    assert await world.next(client) == ("p", {"n": 2})
    world.hub.disconnect(client)
    assert threading.main_thread() not in reads


def test_a_polled_topic_reads_in_threads_and_goes_on_after_an_error():
    _polled()


@in_loop
async def _unread(world):
    reads = []

    def read():
        reads.append(1)

    world.hub.add_kind("p", lambda topic, publish: Polled(topic, publish, read, 0.0))
    client = world.hub.connect()
    world.hub.watch(client, {"p"})
    world.hub.disconnect(client)
    for _ in range(20):
        await asyncio.sleep(0)
    assert reads == []


def test_a_page_that_was_closed_at_once_causes_no_reading():
    _unread()


@in_loop
async def _stored(world):
    world.hub.add_kind("s", lambda _, publish: Stored(publish, lambda: Snapshot.of("s", "now")))
    client = world.hub.connect()
    world.hub.watch(client, {"s"})
    assert await world.next(client) == ("s", "now")


def test_a_stored_topic_begins_with_what_is_known():
    _stored()


@in_loop
async def _closed(world):
    world.hub.watch(world.hub.connect(), {"a:1", "a:2"})
    world.hub.close()
    assert sorted(world.log)[2:] == ["stop a:1", "stop a:2"]


def test_the_end_of_the_server_stops_all_sources():
    _closed()


@pytest.mark.parametrize("topic", ["a", "a:", "a:x:y"])
def test_a_kind_has_the_topics_that_begin_with_its_name(topic):
    async def run():
        world = World()
        client = world.hub.connect()
        world.hub.watch(client, {topic})
        assert client.topics == {topic}

    asyncio.run(run())
