"""Means of iterations without what comes from where their episodes started."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import synthetic_plans
from drcli.analysis.findings.learning_curve import swings
from drcli.analysis.findings.update_advice import without_starts
from drcli.analysis.run import Run
from synthetic_runs import make

NUMBERS = np.arange(20)
NOISE = 0.5 * np.random.default_rng(11).standard_normal(20)


@pytest.fixture(scope="module")
def run() -> Run:
    plan = replace(synthetic_plans.healthy(20003), iterations=4, episodes=4, length_m=6.0)
    return make(plan).as_run()


def started(run: Run, part: np.ndarray) -> Run:
    """With eight episodes an iteration that start at these parts of the lap. Shape (20, 8)."""
    places = int(run.steps["closest_waypoint"].max()) + 1
    starts = {"iteration": np.repeat(NUMBERS, 8), "start_at": (part.ravel() * places).astype(int)}
    return replace(run, episodes=pd.DataFrame(starts))


def test_jumps_that_the_place_of_the_start_makes_are_left_out(run):
    part = np.arange(160).reshape(20, 8) * 0.05 % 1.0
    by_place = 15.0 + 8.0 * np.sin(2.0 * np.pi * part).mean(axis=1)
    jumping = by_place + NOISE

    rest = without_starts(started(run, part), NUMBERS, jumping)

    assert swings(jumping)[0] > 0.3
    assert swings(rest)[0] == pytest.approx(swings(15.0 + NOISE)[0], rel=0.35)


def test_a_short_stretch_that_only_some_iterations_start_at_is_left_out(run):
    """Four workers with two episodes each start at the same two places."""
    part = (np.arange(20)[:, None] * 2 + np.tile([0, 1], 4)) * 0.05 % 1.0
    jumping = 6.0 + 20.0 * np.exp(-(((part - 0.4) / 0.1) ** 2)).mean(axis=1) + NOISE

    rest = without_starts(started(run, part), NUMBERS, jumping)

    assert swings(jumping)[0] > 0.4
    assert swings(rest)[0] < 0.15


@pytest.mark.parametrize("start", ["alike", "random"])
def test_other_jumps_stay_as_large_as_they_are(run, start):
    rng = np.random.default_rng(3)
    part = np.full((20, 8), 0.3) if start == "alike" else rng.random((20, 8))
    jumping = 15.0 + 5.0 * rng.standard_normal(20)

    rest = without_starts(started(run, part), NUMBERS, jumping)

    assert swings(rest)[0] == pytest.approx(swings(jumping)[0], rel=0.2)


def test_nothing_is_left_out_where_no_start_is_known(run):
    unknown = replace(run, episodes=run.episodes.iloc[:0])

    assert np.array_equal(without_starts(unknown, NUMBERS, NOISE), NOISE)
