"""Which messages a training sends, and what happens if they do not arrive."""

import threading

import pytest

from drcli.base.errors import StorageError
from drcli.outside.messages import Channel
from drcli.run.outcome import INTERRUPTED
from drcli.run.run_messages import MOST, Messages
from unwatched import Clock, Watched, ending, job_of, running


class Place:
    """A place for messages that fails so often."""

    def __init__(self, failures=0):
        self.failures = failures
        self.got = []
        self.channel = Channel("the place", self.send)

    def send(self, message):
        if self.failures:
            self.failures -= 1
            raise StorageError("The place does not answer.", remedy="Wait.")
        self.got.append(message)

    @property
    def events(self):
        return [message.event for message in self.got]


class Stage:
    def __init__(self, folder, place, *lines):
        self.run = running(job_of(folder, *lines))
        self.watch, self.clock, self.place = Watched(self.run), Clock(), place
        self.watch.has(0)
        self.duty = Messages(
            self.run,
            self.watch,
            lambda: {"cost": 1.5},
            channels=[place.channel],
            clock=self.clock,
            pause=lambda seconds: None,
        )
        self.duty.start()
        for thread in threading.enumerate():
            if thread.name == "first message":
                thread.join()

    def end(self, code=0, left_s=None, message="It is over."):
        self.duty.after_release(ending(code, left_s, message))
        return self.place.got


@pytest.fixture
def stage(tmp_path):
    return lambda *lines, failures=0: Stage(tmp_path, Place(failures), *lines)


@pytest.mark.parametrize(
    ("code", "event"), [(0, "end"), (6, "failure"), (INTERRUPTED, "interruption")]
)
def test_start_and_end_are_told_with_what_is_known(stage, code, event):
    first, last = stage().end(code)

    assert first.event == "start"
    assert last.event == event
    assert last.text == "It is over."
    assert last.facts["model"] == "s3://bucket/team/model"
    assert last.facts["cost"] == 1.5
    assert last.facts["exit_code"] == code


def test_a_training_that_goes_on_says_where(tmp_path):
    place = Place()
    it = Stage(tmp_path, place)
    it.watch.has(12)
    it.duty._tell_start()
    it.end()

    assert "resume" in place.events
    assert "12_Step-1200.ckpt" in place.got[place.events.index("resume")].text


def test_a_stop_by_a_person_is_told_only_if_wanted(stage, tmp_path):
    assert [m.event for m in stage().end(143)] == ["start"]
    assert [m.event for m in stage("DR_MESSAGE_EVENTS=stop").end(143)] == ["stop"]


def test_events_of_the_journal_become_messages(stage):
    it = stage("DR_MESSAGE_EVENTS=all")
    note = it.run.journal.note
    note("notice", "EC2 takes the machine away.", what="interruption", seconds_left=118)
    note("fault", "No update for 10 minutes.", event="stall")
    note("fault", "The upload failed.", event="upload")
    note("upload", "Uploaded.")
    note("start", "Started.")

    messages = it.end()

    events = ["start", "interruption", "stall", "fault", "upload", "end"]
    assert [message.event for message in messages] == events
    assert messages[1].facts["seconds_left"] == 118


def test_only_wanted_events_are_sent(stage):
    it = stage("DR_MESSAGE_EVENTS=stall,end")
    it.run.journal.note("fault", "sim-0 died.")
    it.run.journal.note("fault", "No update for 10 minutes.", event="stall")

    assert [message.event for message in it.end()] == ["stall", "end"]


def test_a_new_best_is_told_but_not_each_of_many(stage):
    it = stage("DR_MESSAGE_EVENTS=best")
    for best in (3, 5, 7):
        it.watch.has(9, best=best)
        it.duty.check()
        it.clock.now_s += 10.0
    it.clock.now_s += 600.0
    it.duty.check()

    texts = [message.text for message in it.end()]
    assert [text.split()[3] for text in texts] == ["5", "7"]


def test_a_message_is_sent_once_more_before_it_is_given_up(stage, logged):
    it = stage(failures=1)
    it.end()

    assert it.place.events == ["start", "end"]
    assert "could not be sent" not in logged()


def test_a_place_that_is_gone_is_told_once(stage, logged):
    it = stage("DR_MESSAGE_EVENTS=all", failures=100)
    for _ in range(5):
        it.run.journal.note("recovery", "sim-0 was started again.")
    it.end()

    assert logged().count("The place does not answer. Wait.") == 1


def test_a_fault_that_comes_back_floods_nobody(stage):
    it = stage("DR_MESSAGE_EVENTS=all")
    for _ in range(10 * MOST):
        it.run.journal.note("fault", "sim-0 died.")

    messages = it.end()

    assert len(messages) == MOST + 1  # the end is always told
    assert messages[-1].event == "end"
    assert "left out" in messages[-2].text
