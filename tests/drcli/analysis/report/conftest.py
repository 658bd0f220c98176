"""A small training, made and analysed once for all tests of the report."""

from dataclasses import replace

import pytest

from drcli.analysis.analysis import Analysis, analyse
from drcli.analysis.run import Run
from drsim.track.worlds import load_track
from synthetic_plans import healthy
from synthetic_runs import make


@pytest.fixture(scope="session")
def run() -> Run:
    """Six iterations of ten episodes with evaluations, on a track that is known."""
    plan = replace(healthy(3), iterations=6, episodes=10, workers=1, evaluations=2, final=95.0)
    made = make(plan).as_run()
    track = load_track("bean")
    return replace(made, world="bean", track=track)


@pytest.fixture(scope="session")
def analysis(run) -> Analysis:
    """What is found in it."""
    return analyse(run)
