"""State that a reward function keeps outside of its file, where all cars share it (issue 35)."""

from collections.abc import Callable
from pathlib import Path

import pytest

from drcli.model.files.custom_files import InputFile
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import read_source
from drcli.rewards.sandbox.run_sandbox import Sandbox, SandboxRequest, SandboxResult

pytestmark = pytest.mark.nightly

SET_ELSEWHERE = """import math
def reward_function(params):
    gained = params["progress"] - getattr(math, "last_progress", 0.0)
    math.last_progress = params["progress"]
    return gained
"""
IN_THE_ENVIRONMENT = """import os
def reward_function(params):
    last = float(os.environ.get("LAST_PROGRESS", "0"))
    os.environ["LAST_PROGRESS"] = str(params["progress"])
    return params["progress"] - last
"""
IN_A_LIST = """import sys
def reward_function(params):
    sys.warnoptions.append("")
    return float(len(sys.warnoptions))
"""
BY_ITS_OWN_NAME = """import sys
last = 0.0
def reward_function(params):
    me = sys.modules[__name__]
    gained, me.last = params["progress"] - me.last, params["progress"]
    return gained
"""
IN_A_GLOBAL = """last = 0.0
def reward_function(params):
    global last
    gained, last = params["progress"] - last, params["progress"]
    return gained
"""
RANDOM = "import random\ndef reward_function(params):\n    return random.random()\n"
NUMPY = "import numpy as np\ndef reward_function(params):\n    return float(np.random.rand())\n"
OWN_RANDOM = """import random
numbers = random.Random()
def reward_function(params):
    return numbers.random()
"""
TIME = "import time\ndef reward_function(params):\n    return time.perf_counter()\n"
CACHE = """import functools
@functools.cache
def square(x):
    return x * x
def reward_function(params):
    import decimal, colorsys
    colorsys.seen = True
    return square(params["speed"])
"""


@pytest.fixture
def found(
    request_of: Callable[..., SandboxRequest], tmp_path: Path
) -> Callable[[str], SandboxResult]:
    """What the sandbox finds about a file, in a process of its own, which copies itself."""

    def find(text: str) -> SandboxResult:
        with Sandbox(request_of(), text.encode(), tmp_path) as sandbox:
            return sandbox.result()

    return find


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (SET_ELSEWHERE, "math.last_progress"),
        (IN_THE_ENVIRONMENT, 'os.environ["LAST_PROGRESS"]'),
        (IN_A_LIST, ""),
        (BY_ITS_OWN_NAME, ""),
    ],
)
def test_state_that_cars_share_is_found_and_named_if_it_has_a_name(found, text, name):
    result = found(text)

    assert result.failures == []
    assert result.shared is not None
    assert result.shared.times > 0.5 * result.shared.of
    assert result.shared.of == 40
    assert result.shared.names == ([name] if name else [])
    assert result.random is None


@pytest.mark.parametrize("text", [IN_A_GLOBAL, RANDOM, NUMPY, OWN_RANDOM, TIME, CACHE])
def test_what_each_car_has_for_itself_and_chance_are_not_blamed(found, text):
    assert found(text).shared is None


def test_the_warning_says_how_many_rewards_are_wrong_and_what_to_do(found, tmp_path):
    source, _ = read_source(InputFile("mine.py", SET_ELSEWHERE.encode(), "mine.py"))
    assert source is not None

    [problem] = problems_of(source, found(SET_ELSEWHERE), tmp_path)

    assert (problem.rule, problem.severity, problem.line) == ("V-27", "warning", 2)
    assert "`math.last_progress`" in problem.message
    assert "of 40 rewards" in problem.message
    assert "global variable of the file" in problem.remedy
