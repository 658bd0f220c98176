"""What a supervisor does beside its loop."""

import threading

from drcli.base.errors import StorageError
from drcli.run.periodic import Periodic, within

PATIENCE_S = 20.0


def test_a_failure_is_logged_once_and_the_work_goes_on(logged):
    calls, enough = [], threading.Event()

    def work() -> None:
        calls.append(None)
        if len(calls) == 4:
            enough.set()
        raise StorageError("Nothing answers.", remedy="Start it.")

    periodic = Periodic("work", work, 0.001)
    periodic.start()

    assert enough.wait(PATIENCE_S)
    periodic.stop()
    assert logged().count("WARNING work: Nothing answers. Start it.\n") == 1


def test_a_bug_does_not_end_the_work_unseen(logged):
    periodic = Periodic("work", lambda: 1 // 0, 1000.0)
    periodic.start()

    assert periodic.ask(lambda: None).wait(PATIENCE_S)
    periodic.stop()
    assert "ZeroDivisionError" in logged()


def test_an_errand_is_done_at_once_and_says_when_it_is():
    done = []
    periodic = Periodic("work", lambda: None, 1000.0)
    periodic.start()

    assert periodic.ask(lambda: done.append("restarted")).wait(PATIENCE_S)
    periodic.stop()
    assert done == ["restarted"]


def test_an_errand_that_fails_ends_too():
    periodic = Periodic("work", lambda: None, 1000.0)
    periodic.start()

    assert periodic.ask(lambda: 1 // 0).wait(PATIENCE_S)
    periodic.stop()


def test_work_that_takes_too_long_is_left():
    end = threading.Event()

    assert not within(0.01, lambda: end.wait(PATIENCE_S) and None)
    assert not within(PATIENCE_S, lambda: end.wait(PATIENCE_S) and None, lambda: True)
    end.set()
    assert within(PATIENCE_S, lambda: None)


def test_no_errand_is_lost_whenever_it_comes():
    began = threading.Event()
    periodic = Periodic("work", began.set, 1000.0)
    periodic.start()
    assert began.wait(PATIENCE_S)

    errands = [periodic.ask(lambda: None) for _ in range(200)]

    assert all(errand.wait(PATIENCE_S) for errand in errands)
    periodic.stop()
