"""What is known of a reward function is worked out once."""

import pyflakes.checker

from drcli.model.files.custom_files import InputFile
from drcli.rewards.reward_rules import read_source, review_source
from drcli.rewards.reward_style import review_style


def test_pyflakes_runs_once(monkeypatch):
    text = b"import math\n\n\ndef reward_function(params):\n    return bonus\n"
    source, _ = read_source(InputFile("reward_function.py", text, "reward_function.py"))
    assert source is not None
    runs = []

    class Checker(pyflakes.checker.Checker):
        def __init__(self, *arguments, **options):
            runs.append(arguments)
            super().__init__(*arguments, **options)

    monkeypatch.setattr(pyflakes.checker, "Checker", Checker)

    found = [*review_source(source), *review_style(source, console=False)]

    assert sorted(item.message for item in found if item.rule == "V-22") == [
        "'math' imported but unused.",
        "undefined name 'bonus'. A call that reaches this line fails.",
    ]
    assert len(runs) == 1
