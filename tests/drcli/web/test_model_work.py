"""What tasks about models work out."""

from dataclasses import replace

import numpy as np
import pytest

from drcli.web import model_work
from drcli.web.model_work import ends_of
from synthetic_plans import healthy
from synthetic_runs import make


@pytest.fixture(scope="module")
def run():
    plan = replace(healthy(3), iterations=6, episodes=10, workers=1, evaluations=2, final=95.0)
    return make(plan).as_run()


def test_the_ends_of_episodes_are_those_that_did_not_complete_their_lap(run, monkeypatch):
    lost = run.episodes[~run.episodes["complete"].astype(bool)]

    ends = ends_of(run)

    assert 0 < len(lost) < len(run.episodes)
    assert [iteration for iteration, _, _ in ends] == lost["iteration"].tolist()
    first = run.steps[run.steps["unique_episode"] == lost.index[0]].iloc[-1]
    assert np.allclose(ends[0][1:], [first["x"], first["y"]], atol=0.006)
    monkeypatch.setattr(model_work, "MOST_ENDS", 10)
    assert len(ends_of(run)) <= 10
