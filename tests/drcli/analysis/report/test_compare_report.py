"""The page of a comparison."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from drcli.analysis.compare_runs import Comparison, compare_runs
from drcli.analysis.report.compare_report import comparison_page
from synthetic_plans import healthy
from synthetic_runs import make

HOSTILE = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def report(run) -> Comparison:
    """Two trainings, the second longer, with another hyperparameter and without a cost."""
    plan = replace(healthy(5), iterations=125, episodes=2, workers=1, final=95.0)
    files = {"reward_function.py": "same", "hyperparameters.json": '{"lr": 0.0003}'}
    table = run.iterations.assign(wall_s=60.0)
    first = replace(run, name="short", cost_usd=1.5, files=files, iterations=table)
    other = {**files, "hyperparameters.json": '{"lr": 0.001}'}
    second = make(plan).as_run()
    table = second.iterations.assign(wall_s=60.0)
    return compare_runs([first, replace(second, name="long", files=other, iterations=table)])


@pytest.fixture(scope="module")
def html(report) -> str:
    return comparison_page(report)


def graphs_of(html: str) -> dict:
    [text] = re.findall(r'<script type="application/json" id="data">(.*?)</script>', html)
    return json.loads(text)["graphs"]


def test_the_trainings_are_drawn_over_steps_wall_time_and_money(html, report):
    graphs = graphs_of(html)

    names = {key: [line["name"] for line in graph["series"]] for key, graph in graphs.items()}
    assert names["progress-steps"] == names["progress-wall_s"] == ["short", "long"]
    assert names["progress-usd"] == ["short"]
    assert "The cost of long is not known" in html
    assert names["reward-steps"] == ["short", "long"]
    [short, _] = graphs["progress-steps"]["series"]
    np.testing.assert_allclose(short["x"], report.runs[0].curve["steps"], rtol=1e-5)
    np.testing.assert_allclose(short["y"], report.runs[0].curve["progress"], rtol=1e-5)
    assert "the mean of 3 neighbouring iterations" in html


def test_intervals_numbers_and_differences_are_in_it(html, report):
    low = f"{report.pairs[0].progress['low']:+.2f}"

    assert f"{low} to" in html
    assert report.pairs[0].sentence in html
    assert '<span class="added">+  &quot;lr&quot;: 0.001</span>' in html
    assert "late progress" in html


def test_rewards_of_different_functions_are_not_drawn(report):
    pairs = [replace(pair, same_reward=False) for pair in report.pairs]

    assert "reward-steps" not in graphs_of(comparison_page(replace(report, pairs=pairs)))


def test_names_from_files_stay_text(report):
    runs = [replace(run, model=HOSTILE, origin=HOSTILE, world=HOSTILE) for run in report.runs]
    pairs = [
        replace(pair, model=HOSTILE, sentence=HOSTILE, files={HOSTILE: f"-\n+\n+{HOSTILE}"})
        for pair in report.pairs
    ]

    html = comparison_page(replace(report, runs=runs, pairs=pairs, problems=[HOSTILE]))

    assert HOSTILE not in html
    assert html.count("<script") == 4


def test_trainings_without_any_trace_still_have_a_page(report):
    nothing = {name: [] for name in report.runs[0].curve}
    runs = [
        replace(run, iterations=0, wall_s=None, best_lap_s=None, late_progress=None, curve=nothing)
        for run in report.runs
    ]

    html = comparison_page(replace(report, runs=runs, at_equal={}))

    assert graphs_of(html).keys() <= {"reward-steps"}
    assert "no data" in html
