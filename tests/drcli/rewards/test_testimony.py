"""What a witness notices about racers' code: failures, effects and habits."""

import math
import socket

import pytest


def function(body: str, before: str = "") -> str:
    lines = "".join(f"    {line}\n" for line in body.splitlines())
    return f"{before}\ndef reward_function(params):\n{lines}"


def test_a_good_function_is_paid_for_and_nothing_is_said(testify):
    statement = testify(function("return 1.0 - params['distance_from_center']"))

    assert statement.made == 80
    assert all(value is not None for calls in statement.values for value in calls)
    assert statement.returned == {"float": 80}
    assert statement.reads == ["distance_from_center"]
    assert statement.timing is not None
    assert 0 < statement.timing.median_s <= statement.timing.worst_s
    for nothing in ("failures", "effects", "growing", "changed", "unknown", "random", "memory"):
        assert not getattr(statement, nothing), nothing


def test_every_failing_line_is_found_in_one_go(testify):
    text = function("if params['steps'] > 20:\n    return params['sped']\nreturn 1 / 0")

    found = testify(text).failures

    assert {(failure.kind, failure.line) for failure in found} == {("raises", 4), ("raises", 5)}
    missing = next(failure for failure in found if failure.line == 4)
    assert "KeyError: 'sped'" in missing.what
    assert missing.source == "return params['sped']"
    assert missing.first is not None
    assert (missing.first.sequence, missing.first.index) == (0, 19)
    assert missing.times == 42


@pytest.mark.parametrize(
    ("value", "kind"),
    [("float('nan')", "range"), ("1e6", "range"), ("'fast'", "returns"), ("None", "returns")],
)
def test_a_value_that_is_no_reward_is_told_with_its_kind(testify, value, kind):
    [failure] = testify(function(f"return {value}")).failures

    assert failure.kind == kind
    assert failure.times == 80


@pytest.mark.parametrize(
    ("body", "kind"),
    [
        ("raise ValueError(params['x'])", "raises"),
        ("return [params['x']]", "returns"),
        ("return 1e6 + params['x']", "range"),
    ],
)
def test_failures_that_differ_in_numbers_only_are_one(testify, body, kind):
    [failure] = testify(function(body)).failures

    assert (failure.kind, failure.times) == (kind, 80)


def test_what_fails_to_become_a_number_is_of_the_wrong_type(testify):
    before = "class Odd:\n    def __float__(self):\n        raise KeyError\n"

    [failure] = testify(function("return Odd()", before=before)).failures

    assert (failure.kind, failure.times) == ("returns", 80)


def test_an_exception_of_any_kind_is_told(testify):
    before = "class Own(BaseException):\n    def __str__(self):\n        raise ValueError\n"

    [failure] = testify(function("raise Own", before=before)).failures

    assert failure.kind == "raises"
    assert failure.what.endswith("failed: Own.")


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("import no_such.module\n" + function("return 1.0"), "load"),
        (function("import no_such.module\nreturn 1.0"), "raises"),
    ],
)
def test_a_module_that_is_not_there_is_named(testify, text, kind):
    [failure] = testify(text).failures

    assert (failure.kind, failure.missing) == (kind, "no_such")


@pytest.mark.parametrize("body", ["yield 1.0", "return (yield)"])
def test_a_generator_is_one_failure_of_the_file(testify, body):
    statement = testify(function(body))

    assert [failure.kind for failure in statement.failures] == ["load"]
    assert statement.made == 0


def test_what_is_put_in_place_of_pythons_own_is_named_and_put_back(testify):
    sqrt = math.sqrt
    text = function(
        "time.perf_counter = None\nreturn params['speed']",
        before="import builtins, math, time\nmath.sqrt = abs\nbuiltins.len = lambda some: 0",
    )

    statement = testify(text)

    assert set(statement.replaced) == {"math.sqrt", "builtins.len", "time.perf_counter"}
    assert statement.failures == []
    assert math.sqrt is sqrt
    assert len("ab") == 2


def test_a_file_that_does_not_load_is_told_with_its_line(testify):
    statement = testify("def reward_function(params):\n    return 1 +\n")

    assert [(failure.kind, failure.line) for failure in statement.failures] == [("load", 2)]
    assert statement.made == 0


def test_an_exit_is_no_end_but_a_failure(testify):
    [failure] = testify(function("raise SystemExit(0)")).failures

    assert failure.kind == "raises"
    assert "SystemExit" in failure.what


@pytest.mark.parametrize(
    ("value", "name"), [("1", "int"), ("True", "bool"), ("np.float32(1)", "numpy.float32")]
)
def test_other_types_of_numbers_are_named(testify, value, name):
    statement = testify(function(f"return {value}", before="import numpy as np"))

    assert statement.returned == {name: 80}
    assert statement.failures == []


def test_files_are_noticed_with_the_line_that_opens_them(testify, tmp_path):
    table = tmp_path / "line.txt"
    table.write_text("1 2 3")
    log = tmp_path / "log.txt"
    text = function(
        f"with open({str(log)!r}, 'a') as file:\n    file.write('x')\nreturn 1.0",
        before=f"import pathlib; TABLE = pathlib.Path({str(table)!r}).read_text()",
    )

    found = {effect.kind: effect for effect in testify(text).effects}

    assert found["reads"].line == 1
    assert found["reads"].what.endswith(table.name)
    assert found["writes"].line == 3
    assert found["writes"].times == 80


def test_files_of_libraries_and_devices_are_nobodys_business(testify):
    text = function(
        "import json.tool\nopen('/dev/null', 'w').close()\nreturn 1.0", before="import fractions"
    )

    assert testify(text).effects == []


def test_the_network_is_noticed(testify):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        port = here.getsockname()[1]
        text = function(
            f"with socket.socket(type=socket.SOCK_DGRAM) as s:\n"
            f"    s.sendto(b'x', ('127.0.0.1', {port}))\nreturn 1.0",
            before="import socket",
        )

        [effect] = testify(text).effects

    assert (effect.kind, effect.line, effect.times) == ("network", 4, 80)
    assert str(port) in effect.what


def test_threads_and_waiting_are_noticed(testify):
    text = function(
        "thread = threading.Thread(target=int)\nthread.start()\nthread.join()\n"
        "time.sleep(0.0001)\nreturn 1.0",
        before="import threading, time",
    )

    kinds = {effect.kind: effect.line for effect in testify(text, steps=5).effects}

    assert kinds == {"thread": 4, "waits": 6}


def test_a_flood_of_words_is_counted_and_kept_from_the_screen(testify, capsys):
    statement = testify(function("print('step', params['steps'])\nreturn 1.0"))

    assert statement.printed.lines == 80
    assert statement.printed.line == 3
    assert statement.printed.calls == 80
    assert capsys.readouterr() == ("", "")


def test_a_list_that_is_never_emptied_grows(testify):
    statement = testify(function("SEEN.append(params['x'])\nreturn 1.0", before="SEEN = []"))

    [growing] = statement.growing
    assert growing.name == "SEEN"
    assert growing.after - growing.before == 80


def test_what_is_kept_in_a_class_or_in_the_function_itself_grows_too(testify):
    text = function(
        "Memory.seen[len(Memory.seen)] = 1\n"
        "reward_function.steps = getattr(reward_function, 'steps', []) + [1]\nreturn 1.0",
        before="class Memory:\n    seen = {}\n",
    )

    assert {growing.name for growing in testify(text).growing} == {"Memory", "reward_function"}


def test_what_is_emptied_in_each_episode_does_not_grow(testify):
    text = function(
        "if params['steps'] <= 2:\n    SEEN.clear()\nSEEN.append(params['x'])\n"
        "CACHE[params['closest_waypoints'][0]] = 1.0\nreturn float(len(SEEN))",
        before="SEEN = []\nCACHE = {}",
    )

    statement = testify(text)

    assert statement.growing == []
    assert statement.memory is None


def test_what_outlives_the_episode_is_told_with_a_place(testify):
    text = function(
        "global last\npaid = params['progress'] - last\nlast = params['progress']\nreturn paid",
        before="last = 0.0",
    )

    memory = testify(text).memory

    assert memory is not None
    assert (memory.place.sequence, memory.place.index) == (0, 0)
    assert memory.value != memory.other


@pytest.mark.parametrize("value", ["random.random()", "time.perf_counter() % 1"])
def test_chance_and_clocks_are_told_with_two_values(testify, value):
    random = testify(function(f"return {value}", before="import random, time")).random

    assert random is not None
    assert random.times == random.of == 80
    assert random.value != random.other


def test_changed_parameters_are_named_and_do_no_harm(testify):
    statement = testify(
        function("params['speed'] = 9\nparams['waypoints'].pop()\nreturn 1.0 * params['speed']")
    )

    assert statement.changed == {"speed": 80, "waypoints": 80}
    assert statement.memory is None


def test_names_that_are_no_parameters_are_told_with_their_line(testify):
    statement = testify(function("return 1.0 + params.get('distance_from_centre', 0)"))

    assert statement.unknown == {"distance_from_centre": 3}
    assert statement.reads == []


def test_a_function_that_looks_at_all_parameters_reads_all(testify):
    statement = testify(function("return float(len([k for k, v in params.items() if v]))"))

    assert len(statement.reads) == 27
