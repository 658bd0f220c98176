"""The reward guard: what a user's function may do wrong, and what the message then says."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from drsim.episode.load_reward import load_reward_function
from drsim.episode.reward import REWARD_LIMIT, centre_line_reward, checked_reward, checked_rewards
from drsim.episode.reward_deadline import STUCK, alarm
from drsim.errors import RewardError

PARAMS = {"steps": 2.0, "speed": 1.23456789, "waypoints": [(0.0, 0.0), (1.0, 0.0)]}


@pytest.fixture
def write(tmp_path):
    """Write a reward function file and return its path."""

    def write(text: str) -> Path:
        path = tmp_path / "reward_function.py"
        path.write_text(text, encoding="utf-8")
        return path

    return write


ODD_TYPES = """class Odd:
    pass


class Stubborn:
    def __repr__(self):
        raise ValueError("no words")

    def __float__(self):
        raise KeyError("no number")
"""
"""Types of values that no reward function means to return."""

READS = """
def bonus(speed):
    return PARAMS["waypoints"]
"""


def returning(write, expression: str):
    body = f"def reward_function(params):\n    return {expression}\n"
    return load_reward_function(write(body + ODD_TYPES + READS))


@pytest.mark.parametrize(
    ("expression", "reward"),
    [("1.5", 1.5), ("3", 3.0), ("True", 1.0), ("__import__('numpy').float32(0.5)", 0.5)],
)
def test_every_kind_of_number_is_a_reward(write, expression, reward):
    function = returning(write, expression)

    got = checked_reward(function, PARAMS)

    assert type(got) is float
    assert got == reward


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        ("float('nan')", "nan"),
        ("float('inf')", "inf"),
        ("-float('inf')", "-inf"),
        ("'1.0'", "'1.0', which is not a number"),
        ("None", "None, which is not a number"),
        ("[1.0]", "[1.0], which is not a number"),
        ("1.00001e5", "100001.0; rewards must lie between"),
        ("-200_000", "-200000.0; rewards must lie between"),
        ("1j", "1j, which is not a number"),
        ("__import__('numpy').complex128(1)", "which is not a number"),
        ("10**400", "it returned inf; rewards must lie between"),
        ("(x for x in [1.0])", "an object of type generator, which is not a number"),
        ("[0.0] * 1000", "an object of type list, which is not a number"),
        ("Odd()", "an object of type Odd, which is not a number"),
        ("Stubborn()", "an object of type Stubborn, which is not a number"),
    ],
)
def test_what_is_no_reward_is_named_with_the_parameters_that_are_read(write, expression, said):
    function = returning(write, expression)

    with pytest.raises(RewardError) as caught:
        checked_reward(function, dict(PARAMS))

    assert said in str(caught.value)
    assert caught.value.params == {"speed": 1.2346, "waypoints": "<2 points>"}
    assert "<2 points>" in str(caught.value)
    assert caught.value.line == 1


def test_the_limits_themselves_are_rewards(write):
    assert checked_reward(returning(write, "1e5"), PARAMS) == REWARD_LIMIT
    assert checked_reward(returning(write, "-1e5"), PARAMS) == -REWARD_LIMIT


def test_an_exception_names_the_users_file_line_and_text(write):
    path = write(
        "import json\n\ndef helper(params):\n    return json.loads(params['no such key'])\n\n"
        "def reward_function(params):\n    return helper(params)\n"
    )
    function = load_reward_function(path)

    with pytest.raises(RewardError, match="KeyError: 'no such key'") as caught:
        checked_reward(function, PARAMS)

    assert (caught.value.file, caught.value.line) == (path, 4)
    assert caught.value.source == "return json.loads(params['no such key'])"
    assert f"{path}, line 4" in str(caught.value)
    assert isinstance(caught.value.__cause__, KeyError)


def test_an_exception_inside_a_library_names_the_users_line(write):
    path = write("import json\ndef reward_function(params):\n    return json.loads('{')\n")

    with pytest.raises(RewardError) as caught:
        checked_reward(load_reward_function(path), PARAMS)

    assert caught.value.line == 3


@pytest.mark.parametrize(
    "text",
    [
        "import functools\n@functools.lru_cache\ndef reward_function(params):\n    return 1.0\n",
        "class Pay:\n    def __call__(self, params):\n        return params['sped']\n"
        "reward_function = Pay()\n",
        "import functools\ndef pay(k, params):\n    return params['sped']\n"
        "reward_function = functools.partial(pay, 1)\n",
    ],
)
def test_a_failure_behind_a_wrapping_names_the_file(write, text):
    path = write(text)

    with pytest.raises(RewardError) as caught:
        checked_reward(load_reward_function(path), PARAMS)

    assert caught.value.file == path


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("Stubborn()", "an object of type Stubborn"),
        ("list(range(200_000))", "an object of type list"),
        ("'x' * 200_000", "an object of type str"),
        ("[Stubborn()]", ["an object of type Stubborn"]),
        ("[(0.123456, 1)]", [[0.1235, 1]]),
        ("10 ** 9999", "an object of type int"),
    ],
)
def test_what_the_function_puts_among_its_parameters_is_told_in_short(write, value, told):
    body = f"def reward_function(params):\n    params['w'] = {value}\n    return None\n"
    function = load_reward_function(write(body + ODD_TYPES))

    with pytest.raises(RewardError) as caught:
        checked_reward(function, {})

    assert caught.value.params == {"w": told}
    assert len(str(caught.value)) < 500


def test_a_function_that_ends_the_program_is_an_error_and_not_the_end(write):
    function = returning(write, "exit(3)")

    with pytest.raises(RewardError, match="SystemExit"):
        checked_reward(function, PARAMS)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("class E(Exception):\n    def __str__(self): raise ValueError\n", "failed: E."),
        ("class E(BaseException): pass\n", "failed: E."),
        (
            "class E(Exception):\n    def __str__(self): return 'one\\ntwo\\x1b[31m ë'\n",
            r"failed: E: one two\x1b[31m ë.",
        ),
        (
            "class E(Exception):\n    def __str__(self): return 'x' * 9999\n",
            f"failed: E: {'x' * 300}....",
        ),
    ],
)
def test_an_exception_is_told_whatever_it_says_of_itself(write, error, words):
    function = load_reward_function(write(f"{error}def reward_function(params):\n    raise E()\n"))

    with pytest.raises(RewardError) as caught:
        checked_reward(function, PARAMS)

    assert words in str(caught.value).splitlines()[0]


def test_an_interrupt_of_the_user_is_no_failure_of_the_function(write):
    function = load_reward_function(
        write("def reward_function(params):\n    raise KeyboardInterrupt\n")
    )

    with pytest.raises(KeyboardInterrupt):
        checked_reward(function, PARAMS)


@pytest.mark.parametrize(
    "loop", ["while True: pass", "while True:\n        try: 1 / 0\n        except Exception: pass"]
)
def test_an_endless_loop_is_cut_by_the_deadline(write, loop):
    path = write(f"def reward_function(params):\n    {loop}\n")

    with pytest.raises(RewardError, match=r"did not return within 0\.1 s") as caught:
        checked_reward(load_reward_function(path), PARAMS, deadline_s=0.1)

    assert caught.value.line in (2, 3, 4)
    assert caught.value.file == path


@pytest.mark.nightly
@pytest.mark.parametrize(
    "text",
    [
        "def reward_function(params):\n    return os.fork() > 0\n",
        "FORKED = os.fork()\ndef reward_function(params):\n    return FORKED > 0\n",
        "def reward_function(params):\n    return (os.fork() or 1 / 0) > 0\n",
    ],
)
def test_a_copy_that_the_function_makes_of_the_process_does_not_go_on(write, text):
    path = write(f"import os\n{text}")
    script = (
        "import sys; from pathlib import Path\n"
        "from drsim.episode.load_reward import load_reward_function\n"
        "from drsim.episode.reward import checked_reward\n"
        "print(checked_reward(load_reward_function(Path(sys.argv[1])), {}), flush=True)\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", script, path], capture_output=True, text=True, check=True
    )

    assert done.stdout == "1.0\n"


def test_each_call_of_a_batch_has_its_own_deadline(write):
    path = write(
        "import time\ndef reward_function(params):\n"
        "    end = time.perf_counter() + 0.15\n"
        "    while time.perf_counter() < end: pass\n    return 1.0\n"
    )

    rewards = checked_rewards(load_reward_function(path), [PARAMS] * 4, deadline_s=0.4).rewards

    assert rewards == [1.0] * 4


def test_each_call_is_measured_also_one_that_fails(write):
    path = write(
        "def reward_function(params):\n"
        "    params['work'](params['s'])\n    return 1.0 / params['s']\n"
    )
    clock_s = [100.0]

    def work(seconds):
        clock_s[0] += seconds

    calls = [{"work": work, "s": seconds} for seconds in (0.25, 0.0, 2.0)]
    rewarded = checked_rewards(
        load_reward_function(path), calls, on_error=lambda *_: -1.0, now=lambda: clock_s[0]
    )

    assert rewarded.rewards == [4.0, -1.0, 0.5]
    assert rewarded.seconds == [0.25, 0.0, 2.0]


def test_a_call_takes_some_time_even_if_the_function_replaces_the_clock(write):
    path = write(
        "import time\ntime.perf_counter = lambda: -1.0\n"
        "def reward_function(params):\n    return float(sum(range(2000)) > 0)\n"
    )
    before = time.perf_counter
    try:
        [took_s] = checked_rewards(load_reward_function(path), [PARAMS]).seconds
    finally:
        time.perf_counter = before

    assert 0.0 < took_s < 5.0


def test_between_two_calls_no_deadline_counts(write):
    def calls():
        yield {}
        signal.pause()  # until the timer rings
        yield {}

    rewards = checked_rewards(returning(write, "1.0"), calls(), deadline_s=0.1).rewards

    assert rewards == [1.0, 1.0]


def test_a_ring_that_is_heard_after_the_last_call_winds_no_timer():
    left_s, interval_s = signal.setitimer(signal.ITIMER_REAL, 0.0)
    with alarm(50.0, give_up=print) as clock:
        clock.begin()

    clock.ring(signal.SIGALRM, None)
    wound = signal.setitimer(signal.ITIMER_REAL, left_s, interval_s)

    assert wound == (0.0, 0.0)


@pytest.mark.parametrize("where", ["__float__", "__repr__"])
def test_the_deadline_counts_for_methods_of_the_value_too(write, where):
    path = write(
        f"class Odd:\n    def {where}(self):\n        while True: pass\n"
        "def reward_function(params):\n    return Odd()\n"
    )

    with pytest.raises(RewardError, match="did not return within"):
        checked_reward(load_reward_function(path), PARAMS, deadline_s=0.1)


LOOP = """while True:
        try:
            signal.pause()
        except:
            pass
"""


def called_elsewhere(path: Path) -> "subprocess.CompletedProcess[str]":
    """A process of its own that loads a reward function and calls it once, with little patience."""
    script = (
        "import sys, drsim.episode.load_reward, drsim.episode.reward_deadline\n"
        "import drsim.episode.reward\n"
        "from pathlib import Path\n"
        "drsim.episode.reward_deadline.PATIENCE_S = drsim.episode.reward_deadline.REPEAT_S = 0.05\n"
        "drsim.episode.load_reward._IMPORT_DEADLINE_S = 0.1\n"
        "told = sys.excepthook\n"
        "def tell(kind, error, trace):\n"
        "    print(error.kind, error.reason, flush=True)\n"
        "    told(kind, error, trace)\n"
        "sys.excepthook = tell\n"
        "function = drsim.episode.load_reward.load_reward_function(Path(sys.argv[1]))\n"
        "drsim.episode.reward.checked_reward(function, {}, 0.1)\n"
    )
    return subprocess.run(
        [sys.executable, "-c", script, path], capture_output=True, text=True, timeout=60
    )


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("text", "what"),
    [
        (f"import signal\ndef reward_function(params):\n    {LOOP}", "did not return within 0.1 s"),
        (f"import signal\nif signal:\n    {LOOP}", "its import does not end"),
    ],
    ids=["called", "imported"],
)
def test_a_loop_that_swallows_its_deadline_ends_the_process_with_a_sentence(write, text, what):
    path = write(text)

    done = called_elsewhere(path)

    assert done.returncode == 1
    assert f"The reward function in {path}, line 5, failed: " in done.stderr
    assert what in done.stderr
    assert done.stdout.startswith("endless The reward function failed: ")
    assert what in done.stdout


@pytest.mark.nightly
@pytest.mark.parametrize(
    "text",
    [
        "def reward_function(params):\n    pass\n    return float(sum(range(10**12)))",
        "total = 0\n\ntotal = sum(range(10**12))\ndef reward_function(params):\n    return 1.0",
    ],
    ids=["called", "imported"],
)
def test_an_operation_that_python_cannot_interrupt_ends_the_process_and_shows_its_line(write, text):
    path = write(text)

    done = called_elsewhere(path)

    assert done.returncode == -STUCK
    assert f'File "{path}", line 3 in ' in done.stderr


def test_a_profiler_keeps_its_timer(write):
    heard = []
    before = signal.signal(signal.SIGPROF, lambda *_: heard.append("profiler"))
    try:
        signal.setitimer(signal.ITIMER_PROF, 50.0, 50.0)
        checked_reward(returning(write, "1.0"), PARAMS)
        remaining_s, interval_s = signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.raise_signal(signal.SIGPROF)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)

    assert heard == ["profiler"]
    assert remaining_s > 40.0
    assert interval_s == pytest.approx(50.0, abs=0.1)


def test_the_timer_and_handler_of_others_survive(write):
    heard = []
    before = signal.signal(signal.SIGALRM, lambda *_: heard.append("alarm"))
    left_s, interval_s = signal.setitimer(signal.ITIMER_REAL, 50.0)

    try:
        checked_reward(returning(write, "1.0"), PARAMS)
        remaining_s, _ = signal.getitimer(signal.ITIMER_REAL)
        signal.raise_signal(signal.SIGALRM)
    finally:
        signal.setitimer(signal.ITIMER_REAL, left_s, interval_s)
        signal.signal(signal.SIGALRM, before)

    assert 40.0 < remaining_s <= 50.0
    assert heard == ["alarm"]


def test_outside_the_main_thread_rewards_are_computed_without_a_deadline(write):
    function = returning(write, "2.0")
    rewards = []
    thread = threading.Thread(target=lambda: rewards.append(checked_reward(function, PARAMS)))

    thread.start()
    thread.join()

    assert rewards == [2.0]


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(RewardError, match=r"nowhere\.py") as caught:
        load_reward_function(tmp_path / "nowhere.py")

    assert caught.value.kind == "load"
    assert "cannot be read" in caught.value.reason


def test_a_file_that_is_no_text_is_refused_with_the_line(tmp_path):
    path = tmp_path / "reward_function.py"
    path.write_bytes("\n# größe\n".encode("latin-1"))

    with pytest.raises(
        RewardError, match="line 2, contains byte 0xf6, which is not UTF-8"
    ) as caught:
        load_reward_function(path)

    assert caught.value.line == 2


def test_a_byte_order_mark_before_the_text_is_no_part_of_it(tmp_path):
    path = tmp_path / "reward_function.py"
    path.write_text("def reward_function(params):\n    return 2.0\n", encoding="utf-8-sig")

    assert checked_reward(load_reward_function(path), PARAMS) == 2.0


def test_an_expression_that_is_nested_too_deeply_is_refused(write):
    with pytest.raises(RewardError, match="not valid Python"):
        load_reward_function(write(f"x = {'+'.join(['1'] * 100_000)}\n"))


def test_a_syntax_error_names_line_and_text(write):
    with pytest.raises(RewardError, match="not valid Python") as caught:
        load_reward_function(write("def reward_function(params):\n    return 1 +\n"))

    assert caught.value.line == 2
    assert caught.value.source == "return 1 +"


def test_a_file_without_the_function_is_told_what_to_add(write):
    with pytest.raises(RewardError, match=r"Add `def reward_function\(params\):`"):
        load_reward_function(write("def reward(params):\n    return 1.0\n"))


@pytest.mark.parametrize("signature", ["", "a, b", "*, params"])
def test_a_function_of_other_than_one_argument_is_refused(write, signature):
    with pytest.raises(RewardError, match="exactly one argument"):
        load_reward_function(write(f"def reward_function({signature}):\n    return 1.0\n"))


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("def reward_function(params):\n    yield 1.0\n", "contains `yield`"),
        ("async def reward_function(params):\n    return 1.0\n", "begins with `async`"),
        ("async def reward_function(params):\n    yield 1.0\n", "begins with `async`"),
    ],
)
def test_a_function_that_returns_no_value_of_its_own_is_refused(write, function, words):
    with pytest.raises(RewardError, match=words) as caught:
        load_reward_function(write(function))

    assert caught.value.line == 1


@pytest.mark.parametrize(
    "line", ["reward_function = max", "reward_function.__wrapped__ = reward_function"]
)
def test_a_function_whose_arguments_nobody_knows_is_refused(write, line):
    own = "def reward_function(params):\n    return 1.0\n"

    with pytest.raises(RewardError, match="exactly one argument"):
        load_reward_function(write(f"{own}{line}\n"))


def test_a_failing_import_names_its_line(write):
    with pytest.raises(RewardError, match="no_such_package_at_all") as caught:
        load_reward_function(write("import math\nimport no_such_package_at_all\n"))

    assert caught.value.line == 2


def test_the_users_folder_does_not_join_the_import_path(write, tmp_path):
    (tmp_path / "json.py").write_text("raise RuntimeError('shadowed')\n", encoding="utf-8")
    path_before = list(sys.path)

    function = returning(write, "float(bool(__import__('json').dumps({})))")

    assert sys.path == path_before
    assert checked_reward(function, PARAMS) == 1.0


def test_module_globals_live_across_calls(write):
    path = write(
        "calls = 0\ndef reward_function(params):\n"
        "    global calls\n    calls += 1\n    return calls\n"
    )
    function = load_reward_function(path)

    assert checked_rewards(function, [PARAMS] * 3).rewards == [1.0, 2.0, 3.0]


def test_printing_is_allowed(write, capsys):
    path = write("def reward_function(params):\n    print('hello')\n    return 1.0\n")

    checked_reward(load_reward_function(path), PARAMS)

    assert capsys.readouterr().out == "hello\n"


def test_a_changed_file_is_quoted_as_it_is_now(write):
    text = "def reward_function(params):\n    return 1 / {}\n"
    first = load_reward_function(write(text.format("0")))
    with pytest.raises(RewardError):
        checked_reward(first, PARAMS)

    second = load_reward_function(write(text.format("(2 - 2)")))

    with pytest.raises(RewardError) as caught:
        checked_reward(second, PARAMS)
    assert caught.value.source == "return 1 / (2 - 2)"


@pytest.mark.parametrize(
    ("distance_m", "reward"),
    [(0.0, 1.0), (0.1, 1.0), (0.11, 0.5), (0.25, 0.5), (0.4, 0.1), (0.5, 0.1), (0.51, 0.001)],
)
def test_the_centre_line_reward_falls_in_steps(distance_m, reward):
    assert centre_line_reward({"track_width": 1.0, "distance_from_center": distance_m}) == reward


def test_what_a_reward_function_keeps_is_kept_for_each_car(tmp_path):
    path = tmp_path / "reward_function.py"
    path.write_text(
        "calls = 0\n\ndef reward_function(params):\n"
        "    global calls\n    calls += 1\n    return float(calls)\n"
    )
    functions = [load_reward_function(path) for _ in range(2)]

    first = checked_rewards(functions, [PARAMS] * 2).rewards
    second = checked_rewards(functions[:1], [PARAMS]).rewards

    assert (first, second) == ([1.0, 1.0], [2.0])
