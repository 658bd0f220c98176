"""One feed for all: workers are asked for the union of what is looked at, once."""

import pytest

from drcli.live.live_record import LiveMessage
from drcli.web.shared_feed import SharedFeed


class Feed:
    """What a feed was asked."""

    def __init__(self):
        self.opened = 0
        self.wanted = {}
        self.closed = False

    def open(self, directory, on_message, on_gone):
        self.opened += 1
        self.show, self.end = on_message, on_gone
        return self

    def watch(self, run_id, worker, views, car=None):
        self.wanted[run_id, worker] = (list(views), car)

    def workers(self):
        return []

    def close(self):
        self.closed = True


@pytest.fixture
def feed():
    return Feed()


@pytest.fixture
def shared(tmp_path, feed):
    return SharedFeed(tmp_path, feed.open)


def test_workers_are_asked_for_the_union_of_all_wishes(shared, feed):
    page, script = shared.part(lambda *_: None), shared.part(lambda *_: None)
    assert feed.opened == 0, "nobody watches yet"
    page.watch(0, "sim-0", ["scene", "camera"])
    script.watch(0, "sim-0", ["chase", "camera"])
    assert feed.wanted[0, "sim-0"] == (["camera", "chase", "scene"], None)
    page.watch(0, "sim-0", [])
    assert feed.wanted[0, "sim-0"] == (["camera", "chase"], None)
    script.close()
    assert feed.wanted[0, "sim-0"] == ([], None)
    assert feed.opened == 1


def test_the_last_choice_of_a_car_counts_for_all(shared, feed):
    page, other = shared.part(lambda *_: None), shared.part(lambda *_: None)
    page.watch(0, "sim-0", ["scene"])
    shared.look_at(0, "sim-0", 3)
    shared.look_at(0, "sim-0", 5)
    assert feed.wanted[0, "sim-0"] == (["scene"], 5)
    other.watch(0, "sim-0", ["camera"])
    assert feed.wanted[0, "sim-0"] == (["camera", "scene"], 5)
    assert shared.car(0, "sim-0") == 5
    shared.look_at(0, "sim-0", None)
    assert feed.wanted[0, "sim-0"] == (["camera", "scene"], None)


def test_every_part_hears_of_messages_and_of_ends_until_it_is_closed(shared, feed):
    heard, gone = [], []
    page = shared.part(lambda *each: heard.append(each), lambda *each: gone.append(each))
    page.watch(2, "sim-1", ["state"])
    message = LiveMessage("state", 1.0, b"{}")
    feed.show(2, "sim-1", message)
    feed.end(2, "sim-1")
    page.close()
    page.close()
    feed.show(2, "sim-1", message)
    assert heard == [(2, "sim-1", message)]
    assert gone == [(2, "sim-1")]


def test_closing_ends_the_feed(shared, feed):
    shared.close()
    assert not feed.closed, "it was never opened"
    shared.part(lambda *_: None).watch(0, "sim-0", ["scene"])
    shared.close()
    assert feed.closed
