"""SIGTERM and the end of the terminal end a block as an error, after its cleanup."""

import signal

import pytest

from drcli.base.processes import STOPS, NotedSignals, Stopped, handle, restore, until_sigterm


@pytest.mark.parametrize("number", STOPS)
def test_a_signal_ends_the_block_with_cleanup_and_is_handled_as_before_afterwards(number):
    before = signal.getsignal(number)
    cleaned = []

    def work():
        with until_sigterm("The work was stopped.", "Begin again."):
            try:
                signal.raise_signal(number)
            except Exception:
                pytest.fail("it must not look like a failure of the work")
            finally:
                cleaned.append(True)

    with pytest.raises(Stopped, match="The work was stopped") as stopped:
        work()

    assert cleaned == [True]
    assert (stopped.value.code, stopped.value.remedy) == (143, "Begin again.")
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", STOPS)
def test_a_second_signal_does_not_interrupt_the_cleanup(number):
    cleaned = []

    def work():
        with until_sigterm("The work was stopped.", "Begin again."):
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                signal.raise_signal(number)
                cleaned.append(True)

    with pytest.raises(Stopped):
        work()

    assert cleaned == [True]


def test_noted_signals_end_the_work_only_where_it_asks():
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with NotedSignals() as noted:
        noted.refuse("Stopped.", "Begin again.")
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)

        with pytest.raises(Stopped, match="Stopped"):
            noted.refuse("Stopped.", "Begin again.")
        assert noted.count == 2

    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before


def test_ctrl_c_is_a_keyboard_interrupt():
    with NotedSignals() as noted:
        signal.raise_signal(signal.SIGINT)

        with pytest.raises(KeyboardInterrupt):
            noted.refuse("Stopped.", "Begin again.")


def test_the_end_of_the_terminal_is_noted_once_however_often_a_shell_repeats_it():
    with NotedSignals() as noted:
        for _ in range(3):
            signal.raise_signal(signal.SIGHUP)

        with pytest.raises(Stopped):
            noted.refuse("Stopped.", "Begin again.")
        assert noted.count == 1


def test_what_nohup_has_started_goes_on_without_its_terminal():
    own = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        before = handle(lambda *_: pytest.fail("nohup wants it ignored"))
        signal.raise_signal(signal.SIGHUP)
        restore(before)

        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, own)
