"""What a worker shows: read as it was written, and anything else refused."""

import os
import stat

import pytest

from drcli.base.json_record import RecordError
from drcli.live.live_record import (
    LiveAddress,
    LiveCar,
    LiveMessage,
    LiveRacer,
    LiveRequest,
    LiveScene,
    LiveState,
    ShownCar,
    live_file,
)

CAR = LiveCar(
    0,
    0,
    7,
    "training",
    False,
    1.0,
    2.0,
    90.0,
    1.5,
    2.0,
    -30.0,
    12.5,
    0.5,
    4.5,
    "in_progress",
    9,
    0.6,
)


def test_an_address_can_be_read_by_its_owner_only(tmp_path):
    address = LiveAddress.own(4321)
    address.write(tmp_path, "sim-0")

    path = live_file(tmp_path, "sim-0")

    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert LiveAddress.read(path) == address
    assert address.is_usable
    address.delete(tmp_path, "sim-0")
    assert not path.exists()


def test_a_worker_leaves_the_address_of_its_successor_alone(tmp_path):
    LiveAddress.own(1).write(tmp_path, "sim-0")

    LiveAddress.own(2).delete(tmp_path, "sim-0")

    assert live_file(tmp_path, "sim-0").exists()


@pytest.mark.parametrize(
    "text", [b"", b"{", b"[]", b'{"port": 1}', b'{"port": "x", "key": 3}', b"\xff\x00"]
)
def test_a_damaged_address_is_none(tmp_path, text):
    live_file(tmp_path, "sim-0").write_bytes(text)

    assert LiveAddress.read(live_file(tmp_path, "sim-0")) is None


@pytest.mark.parametrize(
    "address",
    [
        LiveAddress(80, "k" * 64, 2**31 - 1, 1.0),
        LiveAddress(80, "k" * 64, os.getpid(), 1.0),
        LiveAddress(0, "k" * 64, os.getpid(), LiveAddress.own(0).pid_started),
        LiveAddress(80, "", os.getpid(), LiveAddress.own(0).pid_started),
        LiveAddress(80, "k" * 64, os.getpid(), LiveAddress.own(0).pid_started, protocol=99),
    ],
)
def test_an_address_of_another_process_or_version_is_of_no_use(address):
    assert not address.is_usable


def test_messages_and_requests_are_read_as_they_were_sent():
    message = LiveMessage("camera", 12.5, b"\xff\xd8", 3, 160, 120)
    request = LiveRequest(("camera", "scene"), 4)

    assert LiveMessage.decode(message.encode()) == message
    assert LiveRequest.decode(request.encode()) == request
    assert LiveRequest.decode(LiveRequest().encode()) == LiveRequest()


def test_a_scene_and_a_state_are_read_as_they_were_written():
    racers = [LiveRacer("model-1", "Blue", (1, 2, 3))]
    shown = ShownCar(0, probabilities=[0.25, 0.75], chosen=1)
    scene = LiveScene(
        "oval", False, "TIME_TRIAL", 3, "3_Step-9.ckpt", racers, [[0.0, 1.0]], [CAR], shown
    )
    state = LiveState("sim-0", 12, "waits for the trainer", True, 5.0, 3, "3_Step-9.ckpt")

    assert LiveMessage("scene", 1.0, scene.encode()).scene == scene
    assert LiveMessage("state", 1.0, state.encode()).state == state


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x00",
        b"\x00\xff{}",
        b"\x00\x02{}",
        b"\x00\x05[1,2]",
        b'\x00\x1e{"view": "boot", "step_s": 1.0}',
        b'\x00\x20{"view": "scene", "step_s": "now"}',
    ],
)
def test_a_damaged_message_is_refused(data):
    with pytest.raises(RecordError):
        LiveMessage.decode(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80\x04K\x01.",
        b"{}{}",
        b'{"views": ["secrets"]}',
        b'{"views": "camera"}',
        b'{"views": [], "car": -1}',
        b'{"views": [], "car": 1e9}',
        b'{"views": [], "car": true}',
    ],
)
def test_a_damaged_request_is_refused(data):
    with pytest.raises(RecordError):
        LiveRequest.decode(data)
