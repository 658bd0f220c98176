"""Numbers survive the way into the page."""

import base64
import json

import numpy as np
import pytest

from drcli.analysis.report.markup import json_text, numbers, quantised


def unpacked(packed) -> np.ndarray:
    """What page.js makes of it."""
    if isinstance(packed, list):
        return np.array([np.nan if value is None else value for value in packed])
    if "f32" in packed:
        return np.frombuffer(base64.b64decode(packed["f32"]), "<f4").astype(float)
    [(kind, least)] = [(kind, least) for kind, least in TYPES.items() if kind in packed]
    integers = np.frombuffer(base64.b64decode(packed[kind]), f"<i{int(kind[1:]) // 8}")
    values = packed["middle"] + integers * packed["step"]
    return np.where(integers == least, np.nan, values)


TYPES = {"i8": -128, "i16": -32768}


@pytest.mark.parametrize("length", [0, 3, 1000])
def test_numbers_come_back(length):
    values = np.linspace(-5.0, 1e6, length)
    values[length // 2 : length // 2 + 1] = np.nan

    np.testing.assert_allclose(unpacked(numbers(values)), values, rtol=1e-5)


def test_numbers_beyond_the_range_are_missing_and_not_infinite():
    values = np.full(1000, 1e300)
    values[1:4] = [np.inf, -np.inf, 2.0]

    found = unpacked(numbers(values))

    assert np.isnan(found[:3]).all()
    assert found[3] == 2.0
    assert numbers([np.inf, 1e300]) == [None, 1e300]


@pytest.mark.parametrize(("kind", "error"), [("i8", 0.05), ("i16", 2e-4)])
def test_small_numbers_come_back_within_half_a_step(kind, error):
    values = np.array([0.0, 1.234, 9.99, np.nan, 50.0])

    found = unpacked(quantised(values, kind, low=0.0, high=10.0))

    np.testing.assert_allclose(found[:3], values[:3], atol=error)
    assert np.isnan(found[3])
    assert found[4] == pytest.approx(10.0)  # cut to the limit


def test_a_single_value_as_the_range_comes_back():
    assert unpacked(quantised([2.0, 2.0], "i8", low=2.0, high=2.0)).tolist() == [2.0, 2.0]


def test_json_cannot_end_its_script_and_has_no_nan():
    value = {"name": "</script><!--", "bad": float("nan"), "list": [float("inf"), 1.5]}

    text = json_text(value)

    assert "<" not in text
    assert json.loads(text) == {"name": "</script><!--", "bad": None, "list": [None, 1.5]}


@pytest.mark.parametrize(("most", "kind"), [(127, "i8"), (32767, "i16"), (40_000, "f32")])
def test_many_integers_come_back_exactly_and_take_little_room(most, kind):
    values = np.linspace(-most, most, 201).round()

    packed = numbers(values)

    assert kind in packed
    np.testing.assert_array_equal(unpacked(packed), values)
