"""Laps that become slower in time while they earn more are named by report and advice alike."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

import synthetic_plans
from drcli.analysis.findings.advice import advise
from drcli.analysis.findings.evidence import gather
from drcli.analysis.report.driving_sections import reward_rate_section
from drcli.analysis.run import Run
from synthetic_runs import make

ITERATIONS = 12


@cache
def made() -> Run:
    """A healthy training whose requested speed does not fall."""
    plan = replace(synthetic_plans.healthy(20003), iterations=ITERATIONS, episodes=10, length_m=6.0)
    return make(plan).as_run()


def evaluated(time_s: np.ndarray, reward: np.ndarray) -> Run:
    """The same with three evaluation laps after each iteration; arrays of shape (iterations,)."""
    number = np.repeat(np.arange(ITERATIONS), 3)
    chance = np.tile([-0.1, 0.0, 0.1], ITERATIONS)
    records = pd.DataFrame(
        {
            "phase": "evaluation",
            "iteration": number,
            "complete": True,
            "status": "lap_complete",
            "progress": 100.0,
            "time": time_s[number] + chance,
            "reward": reward[number] + chance,
        }
    )
    return replace(made(), records=records)


SLOWER, MORE = np.linspace(11.0, 13.4, ITERATIONS), np.linspace(150.0, 190.0, ITERATIONS)


def test_evaluation_laps_that_become_slower_and_earn_more_are_slow_driving():
    run = evaluated(SLOWER, MORE)
    evidence = gather(run)

    item = next(item for item in advise(evidence) if item.id == "slow-driving")

    assert evidence.rate.pays == "slow"
    assert evidence.rate.late_mps > 0.95 * evidence.rate.early_mps
    assert item.numbers["early_lap_s"] == pytest.approx(11.0, abs=0.5)
    assert item.numbers["late_lap_s"] == pytest.approx(13.4, abs=0.5)
    assert evidence.rate.slower.sentence in item.evidence
    unpaid = replace(evidence.rate, slow_s=13.0, slow_reward=0.0, fast_s=11.0, fast_reward=9.0)
    section = reward_rate_section(run, unpaid)
    page = "".join(map(str, section.content))
    assert "Slow laps earn more" in page
    assert "took 13.000 s and earned 0, the faster half took 11.000 s and earned 9" in page
    assert evidence.rate.slower.sentence in page


@pytest.mark.parametrize(
    ("time_s", "reward"),
    [
        (SLOWER, MORE[::-1]),  # slower, but it is not paid for
        (SLOWER, np.full(ITERATIONS, 150.0)),
        (SLOWER[::-1], MORE),  # faster
        (np.linspace(11.0, 11.8, ITERATIONS), MORE),  # a little of it is caution
        (11.0 + 8.0 * (np.arange(ITERATIONS) % 2), MORE),  # chance
    ],
)
def test_other_laps_are_no_slow_driving(time_s, reward):
    evidence = gather(evaluated(time_s, reward))

    assert evidence.rate.slower is None
    assert "slow-driving" not in [item.id for item in advise(evidence)]


def test_laps_of_the_training_count_where_there_is_no_evaluation():
    run = made()
    episodes = run.episodes.copy()
    part = episodes["iteration"] / (ITERATIONS - 1)
    episodes["complete"], episodes["progress"] = True, 100.0
    chance = np.random.default_rng(1).normal(0.0, 0.05, len(episodes))
    episodes["time"] = 10.0 * (1.0 + 0.4 * part + chance)
    episodes["reward"] = 100.0 * (1.0 + 0.4 * part + chance)

    evidence = gather(replace(run, episodes=episodes))

    assert evidence.rate.slower.what == "Training laps"
    assert next(item.id for item in advise(evidence)) == "slow-driving"
