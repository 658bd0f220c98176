"""A training that ends when the process that started it has ended."""

import os
from types import SimpleNamespace

import pytest

from drcli.run.outcome import INTERRUPTED
from drcli.run.watches import ParentWatch


@pytest.fixture
def watch():
    def started(ends_with):
        return ParentWatch(SimpleNamespace(job=SimpleNamespace(ends_with=ends_with)))

    return started


@pytest.mark.parametrize("ends_with", [0, os.getppid()])
def test_a_training_whose_parent_lives_or_does_not_matter_goes_on(watch, ends_with):
    assert watch(ends_with).check() is None


def test_a_training_whose_parent_has_ended_is_interrupted_once(watch):
    duty = watch(os.getpid())  # no process is its own parent

    outcome = duty.check()

    assert outcome.code == INTERRUPTED
    assert not outcome.stays_ended
    assert duty.check() is None
