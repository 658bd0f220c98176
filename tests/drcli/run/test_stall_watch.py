"""Trainings whose processes live and that make no progress."""

import pytest

from drcli.records.job import WorkerExit
from drcli.run.heartbeat_monitor import HeartbeatMonitor
from drcli.run.stall_watch import StallWatch
from watched_run import WatchedRun


class Stage:
    """A run under the stall watch, in steps of ten seconds."""

    def __init__(self, folder, workers=1, minutes=10):
        self.run = WatchedRun(folder, workers, DR_STALL_MINUTES=minutes)
        self.heartbeats = HeartbeatMonitor(folder, self.run.clock)
        self.watch = StallWatch(self.run.running, self.heartbeats)

    def pass_time(self, minutes, working=(), turning=()):
        """Let time pass; the first outcome ends it."""
        for _ in range(int(minutes * 6)):
            self.run.now_s += 10.0
            self.run.write_pulses(working, turning)
            self.heartbeats.look(self.run.children)
            if outcome := self.watch.check():
                return outcome
            for child in self.run.children:
                if child.process.killed:
                    self.watch.died(child, -9, None)
                    self.run.begin(child.name)
                    child.restarts += 1
        return None

    @property
    def restarts(self):
        return {child.name: child.restarts for child in self.run.children if child.restarts}


@pytest.fixture
def stage(tmp_path):
    return Stage(tmp_path)


def test_hours_of_driving_without_an_update_are_no_stall_but_are_said(stage):
    stage.run.say("sim-0", "drives iteration 7")
    stage.run.say("trainer", "waits for rollouts of iteration 7", waits=True)

    assert stage.pass_time(180, working=["sim-0"]) is None

    assert stage.restarts == {}
    assert stage.run.told[0] == (
        "No update for 10 min: the trainer waits for sim-0, alive, last frame 0 s ago."
    )
    assert len(stage.run.told) == 5  # and after 20, 40, 80, 160 minutes
    assert stage.run.warnings == [stage.run.told[-1]]


def test_an_update_takes_the_warning_back(stage):
    stage.run.say("trainer", "waits for rollouts of iteration 7", waits=True)
    stage.pass_time(15, working=["sim-0"])

    stage.pass_time(1, working=["trainer"])

    assert stage.run.warnings == []


def test_a_stuck_worker_is_restarted_once_and_then_the_run_ends(stage):
    stage.run.say("sim-0", "drives iteration 7")
    stage.run.say("trainer", "waits for rollouts of iteration 7", waits=True)
    stage.pass_time(1, working=["sim-0"])

    assert stage.pass_time(12, turning=["trainer"]) is None
    assert stage.restarts == {"sim-0": 1}
    assert stage.run.told == [
        "No progress for 10 min: the trainer waits for sim-0, alive, last frame 10 min ago. "
        "The stuck workers are restarted once."
    ]
    stage.run.say("trainer", "waits for rollouts of iteration 7", waits=True)
    outcome = stage.pass_time(12, turning=["trainer"])

    assert outcome.code == 5
    assert "the trainer waits for sim-0, alive, no frame since its start" in outcome.message
    assert "Restarting the workers did not help." in outcome.message
    assert "--resume" in outcome.remedy
    assert stage.restarts == {"sim-0": 1}


def test_a_restart_that_helps_is_no_reason_to_end_later(stage):
    stage.run.say("sim-0", "drives iteration 7")
    stage.pass_time(12)
    stage.pass_time(5, working=["sim-0", "trainer"])
    assert stage.run.warnings == []

    assert stage.pass_time(12) is None
    assert stage.restarts == {"sim-0": 2, "trainer": 2}


def test_a_worker_that_gets_stuck_again_and_again_before_any_update_ends_the_run(stage):
    def drive_and_stop():
        stage.run.say("sim-0", "drives iteration 7")
        stage.run.say("trainer", "waits for rollouts of iteration 7", waits=True)
        stage.pass_time(1, working=["sim-0"], turning=["trainer"])
        return stage.pass_time(12, turning=["trainer"])

    assert drive_and_stop() is None
    assert drive_and_stop() is None
    outcome = drive_and_stop()

    assert outcome.code == 5
    assert outcome.message.endswith("Restarting the workers did not help.")
    assert stage.restarts == {"sim-0": 2}


def test_workers_that_all_wait_for_each_other_are_all_restarted(stage):
    stage.run.say("sim-0", "waits for the trainer", waits=True)
    stage.run.say("trainer", "waits for rollouts", waits=True)

    assert stage.pass_time(12, turning=["sim-0", "trainer"]) is None

    assert stage.restarts == {"sim-0": 1, "trainer": 1}
    assert "all workers wait for each other" in stage.run.told[0]


def test_a_worker_that_waits_inside_a_call_that_never_ends_is_the_one_to_blame(stage):
    stage.run.say("sim-0", "waits for the trainer", waits=True)
    stage.run.say("trainer", "waits for rollouts", waits=True)

    stage.pass_time(12, turning=["sim-0"])

    assert stage.restarts == {"trainer": 1}


def test_one_stuck_worker_of_two_is_restarted_while_the_other_goes_on(tmp_path):
    stage = Stage(tmp_path, workers=2)
    for name in ("sim-0", "sim-1"):
        stage.run.say(name, "drives iteration 7")

    assert stage.pass_time(31, working=["sim-0", "trainer"]) is None

    assert stage.restarts == {"sim-1": 3}
    assert stage.run.told[0].startswith(
        "sim-1 (drives iteration 7) made no progress for 10 min while others did"
    )


def test_a_bucket_that_is_away_for_an_hour_is_not_the_fault_of_a_worker(stage):
    silent = WorkerExit("No server answers there.", "Wait.", 4, silent=True)
    stage.run.say("sim-0", "drives iteration 7")
    for _ in range(60):
        assert stage.pass_time(1) is None
        stage.watch.died(stage.run.child("sim-0"), 4, silent)

    assert stage.restarts == {}
    [warning] = stage.run.warnings
    assert "No server answers there." in warning
    stage.pass_time(1, working=["sim-0"])
    assert stage.run.warnings == []


def test_without_minutes_nothing_is_a_stall(tmp_path):
    stage = Stage(tmp_path, minutes=0)

    assert stage.pass_time(60) is None
    assert stage.run.told == []
