"""Verdict and advice on recorded trainings of the reference."""

import pytest

from drcli.analysis.findings.advice import advise
from drcli.analysis.findings.evidence import Evidence, gather
from drcli.analysis.findings.verdict import judge


@pytest.fixture(scope="module", params=["drfc-time-trial", "simapp6-continuous"])
def evidence(request, reference_run) -> Evidence:
    return gather(reference_run(request.param))


def test_it_is_improving_and_nothing_is_wrong(evidence):
    assert judge(evidence).kind == "improving"
    assert advise(evidence) == ()


def test_the_car_steers_as_the_track_needs(evidence):
    assert abs(evidence.balance.surplus_deg) < 1.5


def test_the_policy_has_preferences(evidence):
    assert evidence.spread is None or evidence.spread < 0.95


def test_an_evaluation_that_gets_round_cleanly_does_not_pull_to_a_side(evidence):
    newest = evidence.evaluated
    assert newest is None or (newest.laps.clean, newest.laps.driven) == (3, 3)
    assert newest is None or abs(newest.balance.surplus_deg) < 1.5


def test_evaluations_are_ahead_of_the_training(evidence):
    assert evidence.gap.behind < -20
