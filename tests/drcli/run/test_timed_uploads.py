"""Uploads at their times: gently, one after the other, and never the end of a training."""

import pytest

from drcli.run.command_process import CommandEnd
from drcli.run.outcome import INTERRUPTED
from drcli.run.timed_uploads import BEST_EVERY_S, TimedUploads
from unwatched import Clock, Commands, Watched, ending, entries, job_of, running


def done(number):
    report = {"checkpoint": f"{number}_Step-{number}00.ckpt", "target": "s3://uploads/team/model"}
    return CommandEnd(0, report, seconds=2.0)


FAILED = CommandEnd(4, reason="Nobody answers there. Check the network.")


class Stage:
    def __init__(self, folder, *lines, ends=()):
        self.job = job_of(folder, *lines)
        self.run = running(self.job)
        self.watch, self.clock, self.commands = Watched(self.run), Clock(), Commands(*ends)
        self.duty = TimedUploads(self.run, self.watch, start=self.commands, clock=self.clock)
        self.duty.start()

    def after(self, seconds):
        self.clock.now_s += seconds
        assert self.duty.check() is None
        assert self.duty.check() is None


@pytest.fixture
def stage(tmp_path):
    return lambda *lines, ends=(): Stage(tmp_path, *lines, ends=ends)


def test_nothing_is_uploaded_unless_somebody_wants_it(stage):
    it = stage()
    it.watch.has(5, best=3)

    it.after(1e6)
    it.duty.finish(ending(INTERRUPTED, 60.0))

    assert it.commands.started == []


def test_the_last_checkpoint_goes_up_after_each_period(stage):
    it = stage("DR_REGULAR_UPLOAD=30", ends=[done(5), done(9)])
    it.watch.has(5)

    it.after(29 * 60)
    assert it.commands.started == []
    it.after(61)
    it.watch.has(9)
    it.after(29 * 60)
    it.after(61)

    assert [c.arguments for c in it.commands.started] == [("upload-model", "-f", "--json")] * 2
    assert [kind for kind, _ in entries(it.run)] == ["upload", "upload"]
    assert "9_Step-900.ckpt to s3://uploads/team/model" in entries(it.run)[1][1]


def test_what_is_there_already_is_not_sent_again(stage):
    it = stage("DR_REGULAR_UPLOAD=1", ends=[done(5)])
    it.watch.has(5)

    for _ in range(5):
        it.after(61)

    assert len(it.commands.started) == 1


def test_only_one_runs_at_a_time(stage):
    it = stage("DR_REGULAR_UPLOAD=1", "DR_REGULAR_PHYSICAL_MODEL_UPLOAD=1")
    it.watch.has(5)

    it.after(300)
    it.after(300)
    assert it.commands.names == ["upload-model -f"]
    it.commands.started[0].end = done(5)
    it.after(1)

    assert it.commands.names == ["upload-model -f", "upload-car-zip -f"]
    assert "-L" in it.commands.started[1].arguments


def test_a_failure_is_told_once_and_tried_again_at_the_next_time(stage, logged):
    it = stage("DR_REGULAR_UPLOAD=10", ends=[FAILED, FAILED, done(5)])
    it.watch.has(5)

    it.after(601)
    it.after(60)
    assert len(it.commands.started) == 1  # not before its time
    it.after(600)
    it.after(601)

    assert len(it.commands.started) == 3
    kinds = [kind for kind, _ in entries(it.run)]
    assert kinds == ["fault", "recovery", "upload"]
    assert logged().count("Nobody answers there. Check the network.") == 1


def test_a_clock_that_jumps_changes_nothing(stage, monkeypatch):
    it = stage("DR_REGULAR_UPLOAD=60")
    it.watch.has(5)

    monkeypatch.setattr("time.time", lambda: 4e9)
    it.after(10)

    assert it.commands.started == []


def test_new_best_checkpoints_go_up_but_not_all_of_them_at_first(stage):
    it = stage("DR_UPLOAD_BEST_MODEL=True", ends=[done(3), done(7)])
    it.watch.has(2)
    it.after(1)
    assert it.commands.started == []  # nothing was evaluated yet

    it.watch.has(4, best=3)
    it.after(1)
    it.watch.has(6, best=5)
    it.after(1)
    it.watch.has(8, best=7)
    it.after(BEST_EVERY_S)

    assert it.commands.names == ["upload-model -b", "upload-model -b"]


def test_an_interruption_uploads_best_then_archive_each_within_what_is_left(stage):
    it = stage(
        *("DR_REGULAR_UPLOAD=60", "DR_REGULAR_PHYSICAL_MODEL_UPLOAD=60"), ends=[done(7), done(8)]
    )
    it.watch.has(8, best=7)

    it.duty.finish(ending(INTERRUPTED, 100.0))

    assert it.commands.names == ["upload-model -b", "upload-car-zip -f"]
    assert all(90.0 < command.waited_s <= 100.0 for command in it.commands.started)


@pytest.mark.parametrize(
    "wanted",
    ["DR_REGULAR_UPLOAD=60", "DR_UPLOAD_BEST_MODEL=True", "DR_UPLOAD_MODEL_ON_COMPLETION=True"],
)
@pytest.mark.parametrize(("code", "left_s"), [(INTERRUPTED, 60.0), (143, None), (5, None)])
def test_whoever_wants_uploads_has_the_best_model_after_every_end(stage, wanted, code, left_s):
    it = stage(wanted, ends=[done(7)])
    it.watch.has(8, best=7)

    it.duty.finish(ending(code, left_s))

    assert it.commands.names == ["upload-model -b"]


def test_before_the_first_evaluation_an_end_uploads_the_last_checkpoint(stage):
    it = stage("DR_UPLOAD_MODEL_ON_COMPLETION=True", ends=[done(8)])
    it.watch.has(8)

    it.duty.finish(ending(143))

    assert it.commands.names == ["upload-model -f"]


def test_an_end_after_an_upload_of_an_older_checkpoint_uploads_the_best(stage):
    it = stage("DR_REGULAR_UPLOAD=1", ends=[done(8), done(7)])
    it.watch.has(8, best=7)
    it.after(61)

    it.duty.finish(ending(INTERRUPTED, 60.0))

    assert it.commands.names == ["upload-model -f", "upload-model -b"]


def test_an_interruption_uploads_nothing_that_is_there(stage):
    it = stage("DR_REGULAR_UPLOAD=1", ends=[done(8)])
    it.watch.has(8)
    it.after(61)

    it.duty.finish(ending(INTERRUPTED, 100.0))

    assert len(it.commands.started) == 1


def test_a_running_upload_is_killed_when_the_time_is_over(stage):
    it = stage("DR_REGULAR_UPLOAD=1")
    it.watch.has(8)
    it.after(61)

    it.duty.finish(ending(INTERRUPTED, 10.0))

    first = it.commands.started[0]
    assert first.killed
    assert first.waited_s <= 6.0


def test_a_stop_by_a_person_waits_little(stage):
    it = stage("DR_REGULAR_UPLOAD=1", "DR_UPLOAD_BEST_MODEL=True")
    it.watch.has(8, best=7)
    it.after(61)

    it.duty.finish(ending(143))

    running, last = it.commands.started
    assert running.killed
    assert running.waited_s <= 5.0
    assert last.waited_s <= 30.0


def test_a_training_that_lost_its_model_leaves_no_process_behind(stage):
    it = stage("DR_REGULAR_UPLOAD=1")
    it.watch.has(8)
    it.after(61)

    it.duty.after_release(ending(8))

    assert it.commands.started[0].killed
