"""JSON that was damaged is refused with a reason, and never becomes a value of another type."""

import json
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import pytest

from drcli.base.json_record import (
    JsonRecord,
    MaybeNan,
    NewerFormat,
    RecordError,
    from_json,
    parse_json,
)


class Pair(NamedTuple):
    word: str
    number: int | None


@dataclass(frozen=True)
class Inner:
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Outer:
    name: str
    pid: int
    elapsed_s: float
    loss: float = 0.0
    inner: Inner | None = None
    notes: dict[str, float] = field(default_factory=dict)
    pair: Pair | None = None


@dataclass(frozen=True)
class Measured(JsonRecord):
    loss: MaybeNan


WHOLE = {
    "name": "a",
    "pid": 7,
    "elapsed_s": 3,
    "inner": {"sizes": [1, 2]},
    "notes": {"a": 1},
    "pair": ["b", 2],
    "written by a newer version": True,
}


def test_what_is_whole_comes_back_with_its_types():
    found = from_json(Outer, WHOLE)

    assert found == Outer("a", 7, 3.0, 0.0, Inner((1, 2)), {"a": 1.0}, Pair("b", 2))
    assert isinstance(found.pair, Pair)
    assert isinstance(found.elapsed_s, float)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"name": 7}, "'name' cannot be 7"),
        ({"pid": "7"}, "'pid' cannot be"),
        ({"pid": True}, "'pid' cannot be true"),
        ({"pid": -1}, "'pid' cannot be -1"),
        ({"pid": 10**400}, "'pid' cannot be a huge number"),
        ({"elapsed_s": 1e300}, "'elapsed_s' cannot be 1e"),
        ({"loss": float("nan")}, "'loss' cannot be NaN"),
        ({"loss": float("inf")}, "'loss' cannot be Infinity"),
        ({"inner": [1]}, "in 'inner': it is a list"),
        ({"inner": {"sizes": ["x"]}}, "in 'inner': 'sizes' cannot be"),
        ({"inner": {}}, "in 'inner': 'sizes' is missing"),
        ({"pair": ["b"]}, "'pair' cannot be"),
        ({"pair": ["b", "x"]}, "'pair' cannot be"),
        ({"notes": {"a": "x"}}, r"'notes\.a' cannot be"),
    ],
)
def test_a_value_that_a_field_cannot_have_is_named(change, reason):
    with pytest.raises(RecordError, match=reason):
        from_json(Outer, WHOLE | change)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), None])
def test_a_number_that_may_be_unknown_becomes_nan(value):
    assert math.isnan(from_json(Measured, {"loss": value}).loss)


def test_a_record_comes_back_from_its_bytes_and_one_of_a_newer_version_is_refused():
    record = Measured(0.5)

    assert Measured.decode(record.encode()) == record
    assert record.encode() == b'{"loss": 0.5}'
    with pytest.raises(NewerFormat, match="its format is 2, not 1"):
        Measured.decode(b'{"loss": 0.5, "format": 2}')


@pytest.mark.parametrize("version", [0, -1, True, 2.0, "2", None, [2]])
def test_a_format_that_no_version_writes_is_damage(version):
    data = json.dumps({"loss": 0.5, "format": version}).encode()

    with pytest.raises(RecordError, match=r"its format is .*, not 1") as caught:
        Measured.decode(data)

    assert not isinstance(caught.value, NewerFormat)


def test_a_later_version_is_written_and_read():
    @dataclass(frozen=True)
    class Second(Measured):
        VERSION = 2

    assert Second.decode(Second(0.5).encode()) == Second(0.5)
    with pytest.raises(RecordError, match="its format is 1, not 2"):
        Second.decode(Measured(0.5).encode())


@pytest.mark.parametrize(
    "data",
    [b"", b" \n", b"{", b"\xff", b"NaN", b"[Infinity]", b"[" * 100_000, b"9" * 10_000],
)
def test_what_is_not_json_is_refused_with_a_reason(data):
    with pytest.raises(RecordError, match=r"not JSON|empty|not UTF-8"):
        parse_json(data)
