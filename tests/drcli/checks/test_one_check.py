"""A faulty reward function is told in the same words by every check."""

from contextlib import closing
from dataclasses import replace
from threading import Event

import pytest

import sandbox_here
from drcli.checks.before_start import examine
from drcli.config.loading import load_settings
from drcli.model.files.custom_files import find
from drcli.rewards import check, live_check
from drcli.rewards.reward_rules import read_source
from drcli.rewards.reward_style import review_style
from drcli.rewards.scripted_drive import drive
from sandbox_here import SandboxHere


def function(*lines: str, before: str = "") -> str:
    """A reward function whose body is these lines."""
    top = f"{before}\n\n\n" if before else ""
    return f"{top}def reward_function(params):\n" + "".join(f"    {line}\n" for line in lines)


@pytest.fixture(scope="module")
def drive_once():
    """Drives the first race that it is given, and gives the begin of that drive for all others."""
    driven = []

    def once(own, actions):
        if not driven:
            whole = drive(own, actions)
            trips = [replace(trip, calls=trip.calls[:20]) for trip in whole.trips]
            driven.append(replace(whole, trips=trips))
        return driven[0]

    return once


@pytest.fixture
def told(folder, drive_once, monkeypatch):
    """The problems of a reward function by check: rule, severity, line, message and remedy."""
    monkeypatch.setattr("drcli.rewards.tried_reward.Sandbox", SandboxHere)
    monkeypatch.setattr("drcli.rewards.track_grid._MOST_ALONG", 20)
    monkeypatch.setattr(sandbox_here, "driven_once", drive_once)
    monkeypatch.setattr(live_check, "drive", drive_once)

    def tell(text: str):
        folder.settings(DR_WORLD_NAME="bean")
        folder.reward(text)
        settings = load_settings(folder.path, environ={})
        files = find(settings.custom_files, None)
        report, validated = check.check(settings, None, folder.path), folder.report()
        with closing(live_check.LiveCheck()) as checks:
            live = checks.check(settings, text.encode(), folder.path, "", Event())
        found = {
            "dr-reward check": [*report.errors, *report.warnings],
            "dr-validate": [*validated.errors, *validated.warnings],
            "start": examine(settings, files, None).problems,
            "page": live.problems,
        }
        source, _ = read_source(files["reward_function.py"])
        style = review_style(source, console=False) if source is not None else []
        remarks = {(problem.rule, problem.line, problem.message) for problem in style}
        return {
            name: sorted(
                (each.rule, each.severity, each.line or 0, each.message, each.remedy)
                for each in problems
                if each.file.endswith("reward_function.py")
                and each.rule.startswith("V-")  # the others are about what a drive earns
                and (each.rule, each.line, each.message) not in remarks
            )
            for name, problems in found.items()
        }

    return tell


@pytest.mark.parametrize(
    ("text", "rules", "said"),
    [
        (
            function("return 1.0 * params['all_wheels_on_trak'] * params['speed']"),
            ["V-21"],
            ("KeyError", "{'speed': 2.0}", "Did you mean `all_wheels_on_track`?"),
        ),
        (
            function("return 1.0 + params.get('distance_from_centre', 0.0)"),
            ["V-22"],
            ("`distance_from_centre`, which is not a", "Did you mean `distance_from_center`?"),
        ),
        (
            function("if params['steps'] > 90_000:", "    return params['sped']", "return 1.0"),
            ["V-22"],
            ("`sped`, which is not a parameter", "Did you mean `speed`?"),
        ),
        (function("return speed * 1.0"), ["V-22"], ("NameError: name 'speed'", "Correct the name")),
        (function("return 1.0 +"), ["V-02"], ("not valid Python", "Correct that line")),
        (function("if params['x']:", "    pass", "else if 1:"), ["V-24"], ("`elif`",)),
        (function("return 1.0", before="import no_such"), ["V-02"], ("pip install no_such",)),
        (function("return 1 / params['steering_angle']"), ["V-21"], ("{'steering_angle': 0.0}",)),
        (function("if not params['is_offtrack']:", "    return 1.0"), ["V-20"], ("off the track",)),
        (function("return 9.0 * params['steps'] ** 2"), ["V-20"], ("must lie between", "(step ")),
        (
            function("return math.sqrt(params['progress'])", before="import math"),
            ["V-21"],
            ("{'progress': -0.5}", "only in states that few trainings meet", "'warning'"),
        ),
        (function("yield 1.0"), ["V-02"], ("contains `yield`",)),
        ("def reward(params):\n    return 1.0\n", ["V-20"], ("defines no function",)),
        ("def reward_function(a, b):\n    return 1.0\n", ["V-20"], ("exactly one argument",)),
        (function("return 5"), ["V-20"], ("It returned int", "float(reward)")),
        (function("pass"), ["V-20"], ("it returned None", "a path without `return` gives None")),
        (function("return '1.0'"), ["V-20"], ("it returned '1.0'", "without quotes")),
        (function("return (0.5 - 1.0) ** 0.5"), ["V-20"], ("A root of a negative number",)),
        (function("return 1.0,"), ["V-20"], ("it returned (1.0,)", "makes a tuple")),
        (
            function("return np.ones(2)", before="import numpy as np"),
            ["V-20"],
            ("it returned array([1., 1.])", "Return one number of these"),
        ),
        (function("return 1.0 + (params['progress'] == 1)"), ["V-24"], ("progress >= 100",)),
        (function("return 1.0 + (params['steps'] == 1)"), ["V-24"], ("is never true",)),
        (
            function("with open('written.txt', 'w'):", "    print('x')", "return 1.0"),
            ["V-25", "V-25"],
            ("writes or removes files in every call", "prints 1.0 lines per call"),
        ),
        (
            function("math.sqrt = abs", "return math.sqrt(4.0)", before="import math"),
            ["V-21"],
            ("replaces math.sqrt",),
        ),
    ],
)
def test_each_check_says_the_same_about_a_fault(told, text, rules, said):
    found = told(text)

    first, *others = found.values()
    assert [rule for rule, *_ in first] == rules
    assert all(words in str(first) for words in said)
    for other in others:
        assert other == first
