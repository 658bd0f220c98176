"""What the sandbox finds about racers' code: failures, effects and habits."""

import math
import socket

import pytest


def function(body: str, before: str = "") -> str:
    lines = "".join(f"    {line}\n" for line in body.splitlines())
    return f"{before}\ndef reward_function(params):\n{lines}"


def test_a_good_function_is_paid_for_and_nothing_is_said(found):
    result = found(function("return 1.0 - params['distance_from_center']"))

    assert result.calls == 80
    assert all(value is not None for calls in result.values for value in calls)
    assert result.returned == {"float": 80}
    assert result.timing is not None
    assert 0 < result.timing.median_s <= result.timing.worst_s
    for nothing in ("failures", "effects", "random", "memory"):
        assert not getattr(result, nothing), nothing


def test_every_failing_line_is_found_in_one_go(found):
    text = function("if params['steps'] > 20:\n    return params['sped']\nreturn 1 / 0")

    failures = found(text).failures

    assert {(failure.kind, failure.line) for failure in failures} == {("raises", 4), ("raises", 5)}
    missing = next(failure for failure in failures if failure.line == 4)
    assert missing.reason == "KeyError: 'sped'"
    assert missing.params == "{'steps': 21.0}"
    assert missing.source == "return params['sped']"
    assert missing.state.startswith("on the road (step 21, ")
    assert missing.times == 42


@pytest.mark.parametrize(
    ("value", "kind"),
    [("float('nan')", "range"), ("1e6", "range"), ("'fast'", "type"), ("None", "type")],
)
def test_a_value_that_is_no_reward_is_told_with_its_kind(found, value, kind):
    [failure] = found(function(f"return {value}")).failures

    assert failure.kind == kind
    assert failure.times == 80


@pytest.mark.parametrize(
    ("body", "kind"),
    [
        ("raise ValueError(params['x'])", "raises"),
        ("return [params['x']]", "type"),
        ("return 1e6 + params['x']", "range"),
    ],
)
def test_failures_that_differ_in_numbers_only_are_one(found, body, kind):
    [failure] = found(function(body)).failures

    assert (failure.kind, failure.times) == (kind, 80)


def test_what_fails_to_become_a_number_is_of_the_wrong_type(found):
    before = "class Odd:\n    def __float__(self):\n        raise KeyError\n"

    [failure] = found(function("return Odd()", before=before)).failures

    assert (failure.kind, failure.times) == ("type", 80)


def test_an_exception_of_any_kind_is_told(found):
    before = "class Own(BaseException):\n    def __str__(self):\n        raise ValueError\n"

    [failure] = found(function("raise Own", before=before)).failures

    assert failure.kind == "raises"
    assert failure.sentence.startswith("The reward function failed on the start line (step 2, ")


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("import no_such.module\n" + function("return 1.0"), "load"),
        (function("import no_such.module\nreturn 1.0"), "raises"),
    ],
)
def test_a_module_that_is_not_there_is_named(found, text, kind):
    [failure] = found(text).failures

    assert (failure.kind, failure.missing) == (kind, "no_such")


@pytest.mark.parametrize(
    ("text", "line"),
    [("LIMIT = limit\n" + function("return 1.0"), 1), (function("return limit"), 3)],
)
def test_an_undefined_name_is_a_failure_of_its_own_kind(found, text, line):
    [failure] = found(text).failures

    assert (failure.kind, failure.line) == ("undefined", line)


@pytest.mark.parametrize("body", ["yield 1.0", "return (yield)"])
def test_a_generator_is_one_failure_of_the_file(found, body):
    result = found(function(body))

    assert [failure.kind for failure in result.failures] == ["load"]
    assert result.calls == 0


def test_what_is_put_in_place_of_pythons_own_is_named_and_put_back(found):
    sqrt = math.sqrt
    text = function(
        "time.perf_counter = None\nreturn params['speed']",
        before="import builtins, math, time\nmath.sqrt = abs\nbuiltins.len = lambda some: 0",
    )

    result = found(text)

    [failure] = result.failures
    assert failure.kind == "replaces"
    assert all(
        name in failure.reason for name in ("math.sqrt", "builtins.len", "time.perf_counter")
    )
    assert math.sqrt is sqrt
    assert len("ab") == 2


def test_a_file_that_does_not_load_is_told_with_its_line(found):
    result = found("def reward_function(params):\n    return 1 +\n")

    assert [(failure.kind, failure.line) for failure in result.failures] == [("load", 2)]
    assert result.calls == 0


def test_an_exit_is_no_end_but_a_failure(found):
    [failure] = found(function("raise SystemExit(0)")).failures

    assert failure.kind == "raises"
    assert "SystemExit" in failure.reason


@pytest.mark.parametrize(
    ("value", "name"), [("1", "int"), ("True", "bool"), ("np.float32(1)", "numpy.float32")]
)
def test_other_types_of_numbers_are_named(found, value, name):
    result = found(function(f"return {value}", before="import numpy as np"))

    assert result.returned == {name: 80}
    assert result.failures == []


def test_files_are_noticed_with_the_line_that_opens_them(found, tmp_path):
    table = tmp_path / "line.txt"
    table.write_text("1 2 3")
    log = tmp_path / "log.txt"
    text = function(
        f"with open({str(log)!r}, 'a') as file:\n    file.write('x')\nreturn 1.0",
        before=f"import pathlib; TABLE = pathlib.Path({str(table)!r}).read_text()",
    )

    effects = {effect.kind: effect for effect in found(text).effects}

    assert effects["reads"].line == 1
    assert effects["reads"].what.endswith(table.name)
    assert effects["writes"].line == 3
    assert effects["writes"].times == 80


def test_files_of_libraries_and_devices_are_nobodys_business(found):
    text = function(
        "import json.tool\nopen('/dev/null', 'w').close()\nreturn 1.0", before="import fractions"
    )

    assert found(text).effects == []


def test_the_network_is_noticed(found):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        port = here.getsockname()[1]
        text = function(
            f"with socket.socket(type=socket.SOCK_DGRAM) as s:\n"
            f"    s.sendto(b'x', ('127.0.0.1', {port}))\nreturn 1.0",
            before="import socket",
        )

        [effect] = found(text).effects

    assert (effect.kind, effect.line, effect.times) == ("network", 4, 80)
    assert str(port) in effect.what


def test_a_flood_of_words_is_counted_and_kept_from_the_screen(found, capsys):
    result = found(function("print('step', params['steps'])\nreturn 1.0"))

    assert result.printed.lines == 80
    assert result.printed.line == 3
    assert capsys.readouterr() == ("", "")


def test_what_is_emptied_in_each_episode_is_not_memory(found):
    text = function(
        "if params['steps'] <= 2:\n    SEEN.clear()\nSEEN.append(params['x'])\n"
        "CACHE[params['closest_waypoints'][0]] = 1.0\nreturn float(len(SEEN))",
        before="SEEN = []\nCACHE = {}",
    )

    assert found(text).memory is None


def test_what_outlives_the_episode_is_told_with_a_place(found):
    text = function(
        "global last\npaid = params['progress'] - last\nlast = params['progress']\nreturn paid",
        before="last = 0.0",
    )

    memory = found(text).memory

    assert memory is not None
    assert (memory.place.sequence, memory.place.index) == (0, 0)
    assert memory.value != memory.other


def test_differences_of_rounding_are_no_memory(found):
    text = function(
        "global total\ntotal += 1e3\nreturn (total + params['x']) - total + 5.0",
        before="total = 0.0",
    )

    result = found(text)

    assert result.memory is None
    assert result.random is None


@pytest.mark.parametrize("value", ["random.random()", "time.perf_counter() % 1"])
def test_chance_and_clocks_are_told_with_two_values(found, value):
    random = found(function(f"return {value}", before="import random, time")).random

    assert random is not None
    assert random.times == random.of == 80
    assert random.value != random.other


def test_changed_parameters_do_no_harm(found):
    result = found(
        function("params['speed'] = 9\nparams['waypoints'].pop()\nreturn 1.0 * params['speed']")
    )

    assert result.failures == []
    assert result.memory is None


DISCARDS = "class DiscardEpisode(Exception):\n    pass\n\n"


def test_an_episode_declared_broken_is_no_failure_unless_all_are(found):  # 001-17
    some = found(
        function("if params['steps'] > 20:\n    raise DiscardEpisode('lost')\nreturn 1.0", DISCARDS)
    )
    every = found(function("raise DiscardEpisode('lost')", DISCARDS))

    assert some.failures == []
    [failure] = every.failures
    assert (failure.kind, failure.reason) == ("raises", "DiscardEpisode: lost")
