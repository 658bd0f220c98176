"""The file in which a worker says how far it is."""

import os

import pytest

from drcli.records.heartbeat import (
    FILE_BYTES,
    HeartbeatRecord,
    heartbeat_file,
    open_heartbeat_file,
    short_activity,
)

PULSE = HeartbeatRecord(4711, 3, 12.5, "drives iteration 7", False, 41, 12.0, 12.4, 5 * 10**8, 19)


def written(folder, content: bytes) -> None:
    descriptor = open_heartbeat_file(folder, "sim-0")
    os.pwrite(descriptor, content, 0)
    os.close(descriptor)


def test_a_pulse_is_read_as_it_was_written(tmp_path):
    written(tmp_path, PULSE.file_content())

    assert HeartbeatRecord.read(tmp_path, "sim-0") == PULSE
    assert len(PULSE.file_content()) == FILE_BYTES


def test_every_pulse_takes_the_same_room(tmp_path):
    descriptor = open_heartbeat_file(tmp_path, "sim-0")
    for beats in (9, 10**9):
        os.pwrite(
            descriptor, HeartbeatRecord(1, beats, 1.0, "", True, 0, None, 1.0).file_content(), 0
        )
    os.close(descriptor)

    assert heartbeat_file(tmp_path, "sim-0").stat().st_size == FILE_BYTES
    assert HeartbeatRecord.read(tmp_path, "sim-0").beats == 10**9


@pytest.mark.parametrize("cut", [0, 5, 40, 120])
def test_half_of_a_pulse_is_no_pulse(tmp_path, cut):
    newer = HeartbeatRecord(4711, 4, 14.5, "waits for the trainer", True, 50, 14.0, 14.4)
    written(tmp_path, newer.file_content()[:cut] + PULSE.file_content()[cut:])

    assert HeartbeatRecord.read(tmp_path, "sim-0") == (PULSE if cut == 0 else None)


def test_no_file_is_no_pulse(tmp_path):
    assert HeartbeatRecord.read(tmp_path, "sim-0") is None


def test_the_longest_activity_fits():
    activity = short_activity("\u2192\U0001f697 " * 1000)
    heartbeat = HeartbeatRecord(
        2**31 - 1, 2**53, 1e10, activity, False, 2**53, 1e10, 1e10, 2**53, 2**20
    )

    assert len(heartbeat.file_content()) == FILE_BYTES


def test_a_new_process_does_not_write_over_the_pulse_of_an_earlier_one(tmp_path):
    earlier = open_heartbeat_file(tmp_path, "sim-0")
    written(tmp_path, PULSE.file_content())
    os.pwrite(earlier, HeartbeatRecord(1, 1, 1.0, "", True, 0, None, 1.0).file_content(), 0)
    os.close(earlier)

    assert HeartbeatRecord.read(tmp_path, "sim-0") == PULSE
