"""Workers that no longer run although they exist."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from drcli.run import stall_watch
from drcli.run.heartbeat_monitor import HeartbeatMonitor
from drcli.run.stall_watch import FrozenWatch
from watched_run import WatchedRun


class Stage:
    """A run under the watch; processes are what a test says."""

    def __init__(self, folder, monkeypatch):
        self.run = WatchedRun(folder)
        self.heartbeats = HeartbeatMonitor(folder, self.run.clock)
        self.watch = FrozenWatch(self.run.running, self.heartbeats)
        self.state = psutil.STATUS_SLEEPING
        self.used_s = 7.0
        self.uses = 0.0
        self.asked = []
        monkeypatch.setattr(stall_watch.psutil, "Process", lambda pid: self)
        monkeypatch.setattr(os, "kill", lambda pid, number: self.asked.append((pid, number)))

    def status(self):
        return self.state

    def cpu_times(self):
        self.used_s += self.uses
        return type("Times", (), {"user": self.used_s, "system": 0.0})

    def pass_time(self, seconds, silent=()):
        for name in silent:
            self.run.workers[name].beats = False
        for _ in range(seconds // 2):
            self.run.now_s += 2.0
            self.run.write_pulses(turning=["sim-0", "trainer"])
            if outcome := self.watch.check():
                return outcome
        return None


@pytest.fixture
def stage(tmp_path, monkeypatch):
    return Stage(tmp_path, monkeypatch)


def test_a_worker_with_a_pulse_is_left_alone(stage):
    stage.pass_time(600)

    assert not any(child.process.killed for child in stage.run.children)


def test_a_frozen_worker_is_killed_within_forty_seconds_and_named(stage):
    stage.pass_time(10)
    stage.state = psutil.STATUS_STOPPED

    stage.pass_time(40, silent=["sim-0"])

    assert stage.run.child("sim-0").process.killed
    assert not stage.run.child("trainer").process.killed
    assert stage.run.told == ["sim-0 was frozen for 30 s (stopped by a signal); it is replaced."]
    assert stage.run.child("sim-0").ended_by == "frozen"


def test_a_worker_that_sleeps_in_the_kernel_for_good_counts_as_frozen(stage):
    stage.pass_time(10)
    stage.state = psutil.STATUS_DISK_SLEEP

    stage.pass_time(40, silent=["sim-0"])

    assert "waiting for a disk or network drive" in stage.run.told[0]


def test_a_killed_worker_that_the_kernel_keeps_is_replaced_all_the_same(stage):
    child = stage.run.child("sim-0")
    child.process.stubborn = True
    stage.pass_time(10)
    stage.state = psutil.STATUS_DISK_SLEEP

    stage.pass_time(50, silent=["sim-0"])

    assert not child.running
    assert child.process.returncode == -signal.SIGKILL


def test_a_worker_that_computes_without_a_pulse_gets_more_time(stage):
    stage.pass_time(10)
    stage.uses = 1.0

    stage.pass_time(100, silent=["sim-0"])

    assert not stage.run.child("sim-0").process.killed


def test_an_endless_operation_is_a_reason_for_a_new_process_once_its_place_is_in_the_log(stage):
    stage.pass_time(10)
    stage.uses = 1.0
    stage.pass_time(116, silent=["sim-0"])
    assert stage.asked == []

    stage.pass_time(6)
    assert len(stage.asked) == 1
    assert not stage.run.child("sim-0").process.killed
    assert stage.pass_time(10) is None

    assert stage.run.child("sim-0").process.killed
    assert "inside one operation that Python cannot interrupt" in stage.run.told[0]


def test_a_worker_that_is_debugged_is_left_alone(stage):
    stage.pass_time(10)
    stage.state = psutil.STATUS_TRACING_STOP

    stage.pass_time(60, silent=["sim-0"])

    assert not stage.run.child("sim-0").process.killed


def test_a_worker_that_loads_slowly_has_two_minutes_for_its_first_pulse(stage):
    stage.pass_time(100, silent=["sim-0"])
    assert not stage.run.child("sim-0").process.killed

    stage.pass_time(40)

    assert stage.run.child("sim-0").process.killed


def test_a_sleep_of_the_whole_machine_is_nobodys_fault(tmp_path):
    """Here the watch has a real `AwakeClock` on a clock that jumps by hours."""
    from drcli.base.clock import AwakeClock

    run = WatchedRun(tmp_path)
    heartbeats = HeartbeatMonitor(tmp_path, AwakeClock(run.clock))
    watch = FrozenWatch(run.running, heartbeats)
    for step_s in [0.2] * 50 + [8 * 3600.0] + [0.2] * 50:
        run.now_s += step_s
        if step_s < 1.0 and run.now_s < 8 * 3600.0:
            run.write_pulses()  # after the sleep, the workers need ten seconds to come back
        assert watch.check() is None

    assert not any(child.process.killed for child in run.children)


def test_a_process_that_is_really_stopped_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(stall_watch, "STARTING_S", 12.0)
    run = WatchedRun(tmp_path)
    heartbeats = HeartbeatMonitor(tmp_path, run.clock)
    watch = FrozenWatch(run.running, heartbeats)
    child = run.child("sim-0")
    child.process = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(60)"])
    child.process.send_signal(signal.SIGSTOP)
    deadline = time.monotonic() + 20.0
    while psutil.Process(child.process.pid).status() != psutil.STATUS_STOPPED:
        assert time.monotonic() < deadline
        time.sleep(0.01)

    for _ in range(10):
        run.now_s += 2.0
        watch.check()

    assert child.process.wait(20) == -signal.SIGKILL
