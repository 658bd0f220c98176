"""When the duties of a training are called, and what their failures do."""

import threading

import pytest

from drcli.base.errors import StorageError
from drcli.run.duty import Duty, Schedule
from drcli.run.outcome import Outcome
from unwatched import Clock, ending, job_of, running

PATIENCE_S = 20.0


class Noted(Duty):
    """Notes its calls; `check` fails or ends the run."""

    def __init__(self, run, name, calls, result=None):
        super().__init__(run)
        self.name, self.calls, self.result = name, calls, result

    def check(self):
        self.calls.append(self.name)
        if isinstance(self.result, Exception):
            raise self.result
        return self.result

    def finish(self, ending):
        self.check()


@pytest.fixture
def run(tmp_path):
    return running(job_of(tmp_path))


def test_each_duty_is_checked_when_it_is_due_and_the_first_outcome_counts(run):
    calls, clock, end = [], Clock(), Outcome(5, "Enough.")
    slow, ends, last = Noted(run, "slow", calls), Noted(run, "ends", calls), Noted(run, "l", calls)
    slow.check_s = 3.0
    schedule = Schedule([slow, ends, last], clock)

    assert schedule.check() is None
    clock.now_s += 2.0
    ends.result = end
    assert schedule.check() is end
    clock.now_s += 2.0
    assert schedule.check() is end

    assert calls == ["slow", "ends", "l", "ends", "slow", "ends"]


@pytest.mark.parametrize("failure", [StorageError("No answer.", remedy="Wait."), ValueError("x")])
def test_a_duty_that_fails_is_logged_once_and_holds_up_nobody(run, logged, failure):
    calls = []
    schedule = Schedule([Noted(run, "fails", calls, failure), Noted(run, "other", calls)])

    for _ in range(3):
        schedule.check()
    schedule.finish(ending())

    assert calls == ["fails", "other"] * 4
    assert logged().count("WARNING fails: ") == 1


def test_work_has_a_thread_from_the_start_to_the_end(run):
    worked = threading.Event()

    class Works(Duty):
        every_s = 0.001

        def work(self):
            worked.set()

    duty, idle = Works(run), Duty(run)
    schedule = Schedule([duty, idle])

    schedule.start()

    assert worked.wait(PATIENCE_S)
    assert idle.thread is None
    schedule.after_release(ending())
    duty.thread._thread.join(PATIENCE_S)
    assert not duty.thread._thread.is_alive()
