"""Trainings whose cost is sleep use the real loops of workers and trainer."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "bench"))
import scale_fakes


def test_two_workers_and_a_learner_that_only_wait_train(monkeypatch):
    monkeypatch.setattr(scale_fakes.time, "sleep", lambda _: None)

    found = scale_fakes.measured(
        workers=2, lag=2, episodes=4, step_s=0.0, learn_step_s=0.0, iterations=5
    )

    assert found["iterations"] == 2
    assert found["steps"] == pytest.approx(4 * scale_fakes.EPISODE_STEPS, rel=0.5)
    assert 0 <= found["oldest"] <= 2
