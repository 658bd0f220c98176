"""SIGTERM ends a block as an error, after its cleanup."""

import signal

import pytest

from drcli.base.termination import NotedSignals, Stopped, until_sigterm


def test_sigterm_ends_the_block_with_cleanup_and_is_handled_as_before_afterwards():
    before = signal.getsignal(signal.SIGTERM)
    cleaned = []

    def work():
        with until_sigterm("The work was stopped.", "Begin again."):
            try:
                signal.raise_signal(signal.SIGTERM)
            except Exception:
                pytest.fail("it must not look like a failure of the work")
            finally:
                cleaned.append(True)

    with pytest.raises(Stopped, match="The work was stopped") as stopped:
        work()

    assert cleaned == [True]
    assert (stopped.value.code, stopped.value.remedy) == (143, "Begin again.")
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_second_sigterm_does_not_interrupt_the_cleanup():
    cleaned = []

    def work():
        with until_sigterm("The work was stopped.", "Begin again."):
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                signal.raise_signal(signal.SIGTERM)
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
