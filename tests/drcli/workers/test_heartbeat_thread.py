"""The heartbeat that a worker writes."""

import os
import shutil
import subprocess
import sys
import time

from drcli.base.clock import elapsed_s, wait_until
from drcli.records.heartbeat import HeartbeatRecord
from drcli.workers.heartbeat_thread import STACKS_SIGNAL, Heartbeat

STUCK = """
import sys, time
from pathlib import Path
from drcli.workers import heartbeat_thread

heartbeat_thread.BEAT_S = 0.02
beat = heartbeat_thread.Heartbeat()
beat.start(Path(sys.argv[1]), "sim-0")

def reward_function(params):
    time.sleep(60)

reward_function({})
"""


def test_progress_and_activity_are_in_the_pulse():
    heartbeat = Heartbeat()
    before_s = elapsed_s()
    heartbeat.say("drives iteration 7", waits=False)
    heartbeat.step_done()
    heartbeat.step_done()

    record = heartbeat.record()

    assert (record.activity, record.waits, record.work) == ("drives iteration 7", False, 2)
    assert before_s <= record.worked_s <= record.written_s
    assert record.worked_s == record.turned_s
    assert record.pid == os.getpid()
    assert 1e6 < record.memory_bytes < 1e12


def test_waiting_is_no_progress():
    heartbeat = Heartbeat()
    heartbeat.say("waits for the trainer", waits=True)
    heartbeat.turn()

    record = heartbeat.record()

    assert (record.waits, record.work, record.worked_s) == (True, 0, None)


def test_nobody_can_change_the_times_by_setting_the_clock(monkeypatch):
    heartbeat = Heartbeat()
    heartbeat.step_done()
    first = heartbeat.record()
    monkeypatch.setattr(time, "time", lambda: 1.0)
    heartbeat.step_done()

    assert 0.0 <= heartbeat.record().worked_s - first.worked_s < 60.0


def test_a_worker_inside_one_call_has_a_pulse_and_shows_its_stacks_when_it_is_asked(tmp_path):
    log = tmp_path / "log"
    with log.open("wb") as file:
        process = subprocess.Popen([sys.executable, "-c", STUCK, str(tmp_path)], stderr=file)
    try:
        deadline = time.monotonic() + 60.0
        while not (record := HeartbeatRecord.read(tmp_path, "sim-0")) or record.beats < 3:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        os.kill(process.pid, STACKS_SIGNAL)
        while "reward_function" not in log.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert process.poll() is None
    finally:
        process.kill()
        process.wait()


def test_a_pulse_costs_next_to_nothing():
    """A step of the simulation takes milliseconds."""
    heartbeat = Heartbeat()
    begin = time.process_time()
    for _ in range(10_000):
        heartbeat.step_done()

    assert (time.process_time() - begin) / 10_000 < 20e-6


def test_a_pulse_whose_file_is_removed_comes_back(tmp_path, monkeypatch):
    monkeypatch.setattr("drcli.workers.heartbeat_thread.BEAT_S", 0.01)
    Heartbeat().start(tmp_path / "0", "sim-0")
    shutil.rmtree(tmp_path / "0")

    assert wait_until(
        lambda: HeartbeatRecord.read(tmp_path / "0", "sim-0") is not None, patience_s=30
    )


def test_a_pulse_says_how_many_cores_were_busy(monkeypatch):
    clock = iter([(10.0, 1.0), (12.0, 2.0), (14.0, 5.0)])
    heartbeat = Heartbeat()
    told = []
    for now_s, used_s in clock:
        monkeypatch.setattr("drcli.workers.heartbeat_thread.elapsed_s", lambda now_s=now_s: now_s)
        monkeypatch.setattr(
            "drcli.workers.heartbeat_thread.own_processor_s", lambda used_s=used_s: used_s
        )
        told.append(heartbeat.record().cores)

    assert told == [0.0, 0.5, 1.0]
