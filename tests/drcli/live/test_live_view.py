"""What viewers of a worker see, and that they change nothing about the driving."""

import contextlib
import io
import socket
import struct
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from drcli.base.framing import receive
from drcli.drive.driving import rollout_of
from drcli.learn.policy import PolicySpec
from drcli.live import live_server, live_view
from drcli.live.live_record import HOST, LiveMessage, LiveRequest, LiveView, ShownCar, enter, send
from drcli.live.live_scene import BLIND
from drcli.live.live_view import LiveShow
from drcli.live.step_snapshot import StepSnapshot, _said, with_policy
from drsim.race.race import BotRules, ObstacleRules, Race
from drsim.sensing.sensors import Sensors
from live_worker import NETWORK, SOON_S, SmallDrive, shown, until


class Watcher:
    """A viewer without threads."""

    def __init__(self, address, *views: LiveView, car: int | None = None) -> None:
        self.peer = socket.create_connection((HOST, address.port), timeout=SOON_S)
        try:
            enter(self.peer, address.secret)
            self.ask(*views, car=car)
        except Exception:
            self.peer.close()
            raise

    def ask(self, *views: LiveView, car: int | None = None) -> None:
        self.request = LiveRequest(views, car).encode()
        self.repeat()

    def repeat(self) -> None:
        send(self.peer, self.request)

    def next(self, view: LiveView) -> LiveMessage:
        while (message := LiveMessage.decode(receive(self.peer, 1 << 22))).view != view:
            pass
        return message

    def close(self) -> None:
        self.peer.close()


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """These viewers neither read nor write while cars drive, which takes long on a busy machine."""
    monkeypatch.setattr(live_server, "SILENCE_S", 300.0)


@pytest.fixture
def drive():
    drive = SmallDrive()
    yield drive
    drive.close()


def seen(drive: SmallDrive, show: LiveShow, watcher: Watcher, *views: LiveView):
    """One message of each view, while the cars drive."""
    found: dict[LiveView, LiveMessage] = {}
    watcher.peer.settimeout(0.02)
    buffer = b""
    while set(views) - found.keys():
        drive.episodes(show)
        watcher.repeat()
        while True:
            try:
                part = watcher.peer.recv(1 << 20)
            except TimeoutError:
                break
            assert part, "the worker has ended the connection"
            buffer += part
        while len(buffer) >= 4 and len(buffer) >= (end := 4 + int.from_bytes(buffer[:4], "big")):
            message, buffer = LiveMessage.decode(buffer[4:end]), buffer[end:]
            found[message.view] = message
    watcher.peer.settimeout(SOON_S)
    return found


def test_a_viewer_sees_cameras_and_cars(drive, tmp_path):
    with shown(tmp_path) as (show, address):
        show.about(3, "3_Step-90.ckpt")
        watcher = Watcher(address, "camera", "scene")
        found = seen(drive, show, watcher, "camera", "scene", "state")
        watcher.close()

    camera = Image.open(io.BytesIO(found["camera"].data))
    scene, state = found["scene"].scene, found["state"].state
    assert (camera.format, camera.size, camera.mode) == ("JPEG", (160, 120), "L")
    assert (found["camera"].width, found["camera"].height) == (160, 120)
    assert (scene.world, scene.iteration, scene.checkpoint) == (
        "reinvent_base",
        3,
        "3_Step-90.ckpt",
    )
    assert [car.car for car in scene.cars] == [0, 1]
    assert scene.actions == [[0.0, 1.0], [20.0, 1.0], [-20.0, 1.0]]
    assert scene.shown is not None
    assert sum(scene.shown.probabilities) == pytest.approx(1.0, abs=0.01)
    assert scene.shown.car == found["scene"].car
    assert (state.worker, state.activity, state.waits) == ("sim-0", "drives iteration 3", False)
    assert abs(found["scene"].step_s - found["state"].step_s) < SOON_S


def test_a_scene_tells_what_traces_tell(drive, tmp_path):
    """The rows of an episode and the cars of its scenes are the same steps."""
    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "scene")
        rows = {}
        found = None
        while found is None:
            watched = seen(drive, show, watcher, "scene")["scene"].scene
            for episode in drive.episodes():
                rows |= {(episode.number, row.steps): (episode, row) for row in episode.rows}
            found = next((c for c in watched.cars if (c.episode, c.steps) in rows), None)
        watcher.close()

    episode, row = rows[found.episode, found.steps]
    assert (found.x, found.y) == (round(row.x, 3), round(row.y, 3))
    assert found.progress == round(row.progress, 2)
    assert found.reward == round(row.reward, 4)
    assert found.status == row.status
    assert (found.steering_deg, found.asked_mps) == (row.steering_deg, row.speed_mps)
    until_then = [each.reward for each in episode.rows[: found.steps]]
    assert found.total == pytest.approx(sum(until_then), abs=1e-3)


def test_finished_episodes_are_told_with_serial_numbers(drive, tmp_path):
    with shown(tmp_path) as (show, address):
        show.about(4, "4_Step-9.ckpt")
        driven = drive.episodes(show, count=3)  # before anybody watches
        watcher = Watcher(address, "scene")
        scene = seen(drive, show, watcher, "scene")["scene"].scene
        watcher.close()

    first = sorted(scene.finished[:3], key=lambda each: each.episode)
    assert [each.serial for each in scene.finished] == list(range(1, len(scene.finished) + 1))
    assert [each.episode for each in first] == [0, 1, 2]
    assert [each.status for each in first] == [episode.status for episode in driven]
    assert [each.time_s for each in first] == [round(e.duration_s, 3) for e in driven]
    assert [each.steps for each in first] == [episode.steps for episode in driven]
    assert [each.reward for each in first] == [round(e.reward, 4) for e in driven]
    assert {(each.iteration, each.checkpoint) for each in first} == {(4, "4_Step-9.ckpt")}


def test_a_viewer_chooses_its_car(drive, tmp_path):
    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "camera", "scene", car=1)
        found = seen(drive, show, watcher, "camera", "scene")
        watcher.ask("scene", car=99)
        while (scene := seen(drive, show, watcher, "scene")["scene"].scene).shown is not None:
            assert scene.shown.car == 1  # on its way before the second request
        watcher.close()

    assert found["camera"].car == found["scene"].scene.shown.car == 1
    assert len(scene.cars) == 2


def test_driving_is_the_same_to_the_bit_while_somebody_sees_it_from_behind(drive, tmp_path):
    alone = drive.episodes(count=4)
    other, again = SmallDrive(), SmallDrive()

    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "camera", "chase", "scene")
        found = seen(other, show, watcher, "camera", "chase", "scene")
        until(lambda: show.wanted)
        watched = again.episodes(show, count=4)
        watcher.close()
    other.close()
    again.close()

    chase = np.asarray(Image.open(io.BytesIO(found["chase"].data)).convert("RGB"), float)
    middle = chase[120:200, 130:190].reshape(-1, 3)
    assert chase.shape == (240, 320, 3)
    assert (middle[:, 2] - middle[:, 0]).max() > 60, "the car of the settings is blue"

    assert [e.rows for e in alone] == [e.rows for e in watched]
    for name, column in vars(rollout_of(alone)).items():
        np.testing.assert_array_equal(column, getattr(rollout_of(watched), name), err_msg=name)


def test_stereo_cameras_lidar_continuous_actions_and_obstacles(tmp_path):
    sensors = Sensors(("STEREO_CAMERAS", "SECTOR_LIDAR"))
    spec = PolicySpec(2, continuous=True, network=NETWORK, eyes=2, scan_dims=8)
    race = Race(obstacles=ObstacleRules(count=3), bots=BotRules(count=1))
    drive = SmallDrive(spec=spec, sensors=sensors, race=race)
    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "camera", "scene")
        found = seen(drive, show, watcher, "camera", "scene")
        watcher.close()
    drive.close()

    shown_car = found["scene"].scene.shown
    assert Image.open(io.BytesIO(found["camera"].data)).size == (320, 120)
    assert len(shown_car.lidar) == 8
    assert [each.kind for each in shown_car.objects] == ["box_obstacle"] * 3 + ["bot_car"]
    assert shown_car.probabilities is None
    assert shown_car.low[0] < shown_car.mean[0] < shown_car.high[0]


def test_two_racers_see_each_other(tmp_path):
    drive = SmallDrive(race=Race(racers=2))
    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "scene")
        scene = seen(drive, show, watcher, "scene")["scene"].scene
        watcher.close()
    drive.close()

    assert [each.kind for each in scene.shown.objects] == ["race_car"]


def test_between_episodes_a_viewer_reads_what_the_worker_waits_for(tmp_path):
    doing = ["waits for the trainer (checkpoint 4)", True]
    with shown(tmp_path, activity=lambda: (doing[0], doing[1])) as (_, address):
        watcher = Watcher(address, "camera")
        first = watcher.next("state").state
        doing[:] = ["drives iteration 4", False]
        while (second := watcher.next("state").state).waits:
            assert second.activity == first.activity
        watcher.close()

    assert (first.activity, first.waits) == ("waits for the trainer (checkpoint 4)", True)
    assert second.activity == "drives iteration 4"
    assert second.since_s >= first.since_s


def test_nobody_watching_means_no_step_is_wanted(drive, tmp_path):
    with shown(tmp_path) as (show, address):
        drive.episodes(show)
        assert not show.wanted
        watcher = Watcher(address, "scene")
        until(lambda: show.wanted)
        watcher.close()
        until(lambda: not (show._server.viewers or show.wanted))
        watcher = Watcher(address)  # the state alone needs no steps
        assert watcher.next("state").state.pid
        assert not show.wanted
        watcher.close()


def test_a_picture_that_fails_does_not_end_the_driving_nor_the_view(drive, tmp_path, monkeypatch):
    monkeypatch.setattr(live_view, "FAILURE_PAUSE_S", 0.0)
    monkeypatch.setattr(live_view, "camera_picture", lambda frames: 1 / 0)
    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "camera", "scene")
        until(lambda: show.wanted)
        drive.episodes(show)
        watcher.ask("scene")
        found = seen(drive, show, watcher, "scene")
        watcher.close()

    assert found["scene"].scene.cars


def test_without_pillow_the_state_says_why_there_are_no_pictures(drive, tmp_path, monkeypatch):
    monkeypatch.setattr(live_view, "missing_library", lambda: "Pictures need pillow.")
    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "camera", "chase", "scene")
        found = seen(drive, show, watcher, "scene", "state")
        watcher.close()

    assert found["state"].state.hint == "Pictures need pillow."
    assert found.keys() == {"scene", "state"}


def test_a_viewer_that_does_not_read_blocks_nobody_and_is_sent_away(drive, tmp_path, monkeypatch):
    monkeypatch.setattr(live_server, "SILENCE_S", 0.2)
    with shown(tmp_path) as (show, address):
        lazy = Watcher(address, "camera", "scene")
        until(lambda: show._server.viewers)
        while show._server.viewers:
            drive.episodes(show)
        busy = Watcher(address, "scene")
        assert seen(drive, show, busy, "scene")["scene"].scene.cars
        lazy.close()
        busy.close()


@pytest.mark.parametrize(
    "words",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n" + b"x" * 64,
        bytes(range(256)) * 4,
        b"\x80\x04\x95" + b"\x00" * 61,
        struct.pack(">I", 1 << 31) + b"x" * 60,
    ],
)
def test_visitors_that_do_not_know_the_key_are_sent_away(tmp_path, words):
    with shown(tmp_path) as (show, address):
        received = b""
        with socket.create_connection((HOST, address.port), timeout=SOON_S) as peer:
            peer.sendall(words)
            # The server may have hung up by now.
            with contextlib.suppress(OSError):
                peer.shutdown(socket.SHUT_WR)
            with contextlib.suppress(ConnectionResetError):
                while part := peer.recv(4096):
                    received += part

        assert len(received) <= 64, "nothing but a greeting"
        assert not show._server.viewers
        watcher = Watcher(address)
        assert watcher.next("state").state.worker == "sim-0"
        watcher.close()


@pytest.mark.parametrize("words", [b"{", b'{"views": ["keys"]}', b"\x80\x04K\x01.", b"x" * 5000])
def test_a_viewer_that_asks_nonsense_is_sent_away(tmp_path, words):
    with shown(tmp_path) as (show, address):
        peer = socket.create_connection((HOST, address.port), timeout=SOON_S)
        enter(peer, address.secret)
        send(peer, words)
        with contextlib.suppress(ConnectionResetError):
            assert peer.recv(100) == b""
        peer.close()
        until(lambda: not show._server.viewers)


def test_there_is_room_for_a_few_viewers_and_the_others_are_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(live_server, "MOST_VIEWERS", 2)
    with shown(tmp_path) as (_, address):
        first, second = Watcher(address), Watcher(address)
        assert first.next("state").state.pid
        assert second.next("state").state.pid
        third = socket.create_connection((HOST, address.port), timeout=SOON_S)
        assert third.recv(100) == b""
        third.close()
        first.close()

        def enters() -> bool:
            try:
                Watcher(address).close()
            except Exception:
                return False
            return True

        until(enters)
        second.close()


@pytest.mark.parametrize("continuous", [False, True])
def test_what_the_networks_said_is_what_asking_them_again_gives(tmp_path, continuous):
    drive = SmallDrive(spec=PolicySpec(2 if continuous else 3, continuous, NETWORK))
    moments: list[StepSnapshot] = []
    with shown(tmp_path) as (show, address):
        watcher = Watcher(address, "scene")
        seen(drive, show, watcher, "scene")
        until(lambda: show._tap.active)
        show.see = lambda moment: moments.append(replace(moment, calls=show._tap.take()))
        show._tap.active = True
        while not moments:
            until(lambda: show.wanted)
            drive.episodes(show)
        watcher.close()
    drive.close()

    moment = moments[0]
    for rider in moment.riders:
        look, row = moment.look_of(rider.car)
        told = with_policy(ShownCar(rider.car), look, row, moment.calls)
        again = with_policy(ShownCar(rider.car), look, row)
        assert _said(look.seen.frames[row : row + 1], moment.calls) is not None
        assert told.probabilities == pytest.approx(again.probabilities, abs=1e-3)
        assert told.mean == pytest.approx(again.mean, abs=1e-3)
        assert told.low == pytest.approx(again.low, abs=1e-3)


def test_a_teacher_has_no_camera_and_the_viewers_are_told(drive, tmp_path):
    drive.teach()
    with shown(tmp_path) as (show, address):
        show.about(3, "3_Step-90.ckpt", replace(show.facts, hint=BLIND))
        watcher = Watcher(address, "camera", "scene")
        found = seen(drive, show, watcher, "camera", "scene", "state")
        watcher.close()

    picture = np.asarray(Image.open(io.BytesIO(found["camera"].data)))
    assert picture.shape == (120, 160)
    assert picture.std() > 10.0  # there are words on it
    assert found["state"].state.hint == BLIND
    scene = found["scene"].scene
    assert {car.racer for car in scene.cars} == {0}
    assert scene.shown is not None
    assert scene.shown.probabilities is not None
    assert scene.shown.lidar == []
