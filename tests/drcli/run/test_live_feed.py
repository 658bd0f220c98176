"""The console finds workers of this machine, follows them, and finds them again."""

import contextlib
import os
import socket
from dataclasses import replace

import pytest

from drcli.live import live_feed
from drcli.live.live_feed import LiveFeed, LiveWorker
from drcli.live.live_record import HOST, LiveAddress, live_file
from drcli.records.run_record import run_folder
from live_worker import Received, SmallDrive, shown, until

POLL_S = 0.02


@pytest.fixture
def received():
    return Received()


@pytest.fixture
def feed(tmp_path, received):
    feed = LiveFeed(tmp_path, received.take, received.leave, poll_s=POLL_S)
    with contextlib.closing(feed):
        yield feed


def test_a_worker_is_watched_and_left(tmp_path, feed, received):
    drive = SmallDrive()
    with shown(tmp_path) as (show, _):
        assert feed.workers() == [LiveWorker(0, "sim-0", os.getpid())]
        feed.watch(0, "sim-0", {"scene"})
        until(lambda: show.wanted)
        assert feed.workers() == [LiveWorker(0, "sim-0", os.getpid(), watched=True)]
        while received.messages.qsize() < 2:
            drive.episodes(show)
        assert received.next("scene").scene.cars
        feed.watch(0, "sim-0", ())
        until(lambda: not show._server.viewers)
    drive.close()


def test_views_and_car_change_without_a_new_connection(tmp_path, feed, received):
    with shown(tmp_path) as (show, _):
        feed.watch(0, "sim-0", {"state"})
        assert received.next("state").state.worker == "sim-0"
        [viewer] = show._server.viewers
        feed.watch(0, "sim-0", {"camera", "scene"}, car=1)
        until(lambda: viewer.request.views == ("camera", "scene") and viewer.request.car == 1)
        assert show._server.viewers == (viewer,)


def test_a_worker_that_starts_later_ends_and_comes_back_is_followed(tmp_path, feed, received):
    feed.watch(0, "sim-0", {"state"})
    for _ in range(2):
        with shown(tmp_path):
            assert received.next("state").state.worker == "sim-0"
        assert received.gone.get(timeout=20.0) == (0, "sim-0")
        received.messages.queue.clear()  # a second state of this worker is none of the next one
    assert feed.workers() == []


def test_evaluations_and_several_runs_have_names_of_their_own(tmp_path, feed, received):
    folder = run_folder(tmp_path, 3) / "evaluations" / "20260102030405"
    with shown(tmp_path) as (_, address), shown(tmp_path, name="sim-1", run_id=2):
        address.write(folder, "evaluation")

        names = [(worker.run_id, worker.worker) for worker in feed.workers()]
        feed.watch(3, "evaluation-20260102030405", {"state"})

        assert names == [(0, "sim-0"), (2, "sim-1"), (3, "evaluation-20260102030405")]
        assert received.messages.get(timeout=20.0)[:2] == (3, "evaluation-20260102030405")


def test_files_of_workers_that_have_ended_and_damaged_files_are_nothing(tmp_path, feed):
    folder = run_folder(tmp_path, 0)
    LiveAddress(1, "k" * 64, 2**31 - 1, 1.0).write(folder, "sim-0")
    for number, text in enumerate([b"", b"{", b"[" * 9999, b"\xff", b'{"port": -1}']):
        live_file(folder, f"sim-{number + 1}").write_bytes(text)
    live_file(folder, "fifo").symlink_to("/dev/zero")
    (run_folder(tmp_path, 0).parent / "notes").mkdir()
    LiveAddress.own(5).write(run_folder(tmp_path, 0).parent / "notes", "sim-0")

    assert feed.workers() == []


def everything_heard(peer: socket.socket) -> bytes:
    """What the other end says until it hangs up, which may be before this end does."""
    heard = bytearray()
    with contextlib.suppress(OSError):  # not connected: it has reset the connection
        peer.shutdown(socket.SHUT_WR)
    with contextlib.suppress(ConnectionError):
        while more := peer.recv(4096):
            heard += more
    return bytes(heard)


@pytest.mark.parametrize("words", [b"", b"HTTP/1.1 200 OK\r\n\r\n" + b"x" * 99, b"\x00" * 200])
def test_another_program_at_the_port_of_a_worker_gets_no_key(tmp_path, feed, received, words):
    with socket.create_server((HOST, 0)) as listener:
        address = replace(LiveAddress.own(listener.getsockname()[1]))
        address.write(run_folder(tmp_path, 0), "sim-0")
        feed.watch(0, "sim-0", {"camera"})
        heard = []
        for _ in range(2):  # it comes again, because a worker may listen there some time
            peer, _ = listener.accept()
            with peer:
                peer.sendall(words)
                heard.append(everything_heard(peer))

    assert not any(address.secret in each for each in heard)
    assert received.messages.empty()
    assert received.gone.empty()


def test_a_key_of_an_earlier_worker_opens_nothing(tmp_path, feed, received):
    with shown(tmp_path) as (show, address):
        replace(address, key="0" * 64).write(run_folder(tmp_path, 0), "sim-0")
        feed.watch(0, "sim-0", {"state"})
        address.write(run_folder(tmp_path, 0), "sim-0")
        assert received.next("state").state.worker == "sim-0"
        assert len(show._server.viewers) == 1


def test_a_worker_that_falls_silent_is_given_up(tmp_path, received, monkeypatch):
    monkeypatch.setattr(live_feed, "SILENCE_S", 0.1)
    feed = LiveFeed(tmp_path, received.take, received.leave, poll_s=POLL_S)
    with shown(tmp_path), contextlib.closing(feed):
        feed.watch(0, "sim-0", {"state"})

        assert received.gone.get(timeout=20.0) == (0, "sim-0")


def test_nothing_is_called_back_after_the_end(tmp_path, received):
    with shown(tmp_path):
        feed = LiveFeed(tmp_path, received.take, received.leave, poll_s=POLL_S)
        feed.watch(0, "sim-0", {"state"})
        received.next("state")
        feed.close()
        count = received.messages.qsize()

        assert received.gone.empty()
        assert received.messages.qsize() == count
