"""JSON that was damaged is refused with a reason, and never becomes a value of another type."""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from drcli.base.json_record import (
    JsonRecord,
    NewerFormat,
    Pid,
    RecordError,
    SafeInt,
    Seconds,
    decode_json,
    from_json,
    plain_json,
)


class Pair(NamedTuple):
    word: str
    number: SafeInt | None


@dataclass(frozen=True)
class Inner:
    sizes: tuple[SafeInt, ...]


@dataclass(frozen=True)
class Outer:
    name: str
    pid: Pid
    elapsed_s: Seconds
    loss: float = 0.0
    inner: Inner | None = None
    notes: dict[str, float] = field(default_factory=dict)
    pair: Pair | None = None
    folder: Path | None = None


@dataclass(frozen=True)
class Measured(JsonRecord):
    loss: float


WHOLE = {
    "name": "a",
    "pid": 7,
    "elapsed_s": 3,
    "inner": {"sizes": [1, 2]},
    "notes": {"a": 1},
    "pair": ["b", 2],
    "folder": "data",
    "written by a newer version": True,
}
EXPECTED = Outer("a", 7, 3.0, 0.0, Inner((1, 2)), {"a": 1.0}, Pair("b", 2), Path("data"))


def test_what_is_whole_comes_back_with_its_types():
    found = decode_json(Outer, json.dumps(WHOLE).encode())

    assert found == EXPECTED == from_json(Outer, WHOLE)
    assert isinstance(found.pair, Pair)
    assert isinstance(found.elapsed_s, float)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"name": 7}, r"Expected `str`, got `int` - at `\$\.name`"),
        ({"pid": "7"}, r"Expected `int`, got `str` - at `\$\.pid`"),
        ({"pid": True}, "got `bool`"),
        ({"pid": -1}, "Expected `int` >= 1"),
        ({"pid": 2**31}, "Expected `int` <= 2147483647"),
        ({"pid": 10**400}, "Expected `int` <= 2147483647"),
        ({"elapsed_s": 1e300}, r"Expected `float` <= 100000000000.0 - at `\$\.elapsed_s`"),
        ({"loss": float("nan")}, "JSON is malformed"),
        ({"loss": float("inf")}, "JSON is malformed"),
        ({"inner": []}, r"got `array` - at `\$\.inner`"),
        ({"inner": {"sizes": ["x"]}}, r"at `\$\.inner\.sizes\[0\]`"),
        ({"inner": {"sizes": [2**53 + 1]}}, r"at `\$\.inner\.sizes\[0\]`"),
        ({"inner": {}}, r"missing required field `sizes` - at `\$\.inner`"),
        ({"pair": ["b"]}, r"at `\$\.pair`"),
        ({"pair": ["b", "x"]}, r"at `\$\.pair\[1\]`"),
        ({"notes": {"a": "x"}}, r"at `\$\.notes\[\.\.\.\]`"),
        ({"folder": 3}, r"it is not a Path - at `\$\.folder`"),
    ],
)
def test_a_value_that_a_field_cannot_have_is_named(change, reason):
    with pytest.raises(RecordError, match=reason):
        decode_json(Outer, json.dumps(WHOLE | change).encode())


def test_a_number_out_of_range_is_refused():
    with pytest.raises(RecordError, match="out of range"):
        Measured.decode(b'{"loss": 1e999}')


def test_a_record_comes_back_from_its_bytes_and_one_of_a_newer_version_is_refused():
    record = Measured(0.5)

    assert Measured.decode(record.encode()) == record
    assert record.encode() == b'{"loss": 0.5}'
    with pytest.raises(NewerFormat, match="its format is 2, not 1"):
        Measured.decode(b'{"loss": 0.5, "format": 2}')


@pytest.mark.parametrize("version", [0, -1, True, 2.0, "2", None, [2]])
def test_a_format_that_no_version_writes_is_damage(version):
    data = json.dumps({"loss": 0.5, "format": version}).encode()

    with pytest.raises(RecordError, match=r"at `\$\.format`") as caught:
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
    [
        *(b"", b" \n", b"{", b"\xff", b'"\xff"', b'{"\xff": 1}', b"NaN", b"[Infinity]"),
        *(b"[" * 100_000, b"9" * 10_000),
    ],
)
def test_what_is_not_json_is_refused_with_a_reason(data):
    with pytest.raises(RecordError, match=r"."):
        decode_json(dict[str, Any], data)


def test_nan_is_never_written():
    with pytest.raises(ValueError, match="not JSON compliant"):
        Measured(math.nan).encode()


def test_numbers_of_numpy_are_written_as_numbers():
    assert Measured(np.float64(0.5)).encode() == b'{"loss": 0.5}'


def test_paths_and_nested_records_become_plain():
    assert plain_json(Outer("a", 7, 3.0, inner=Inner((1,)), folder=Path("x"))) == {
        "name": "a",
        "pid": 7,
        "elapsed_s": 3.0,
        "loss": 0.0,
        "inner": {"sizes": [1]},
        "notes": {},
        "pair": None,
        "folder": "x",
    }


@pytest.mark.parametrize("folder", ["caf\udce9", "caf\u00e9", "\U0001f3ce"])
def test_a_path_that_is_not_utf_8_comes_back(folder):
    data = json.dumps(plain_json(replace(EXPECTED, folder=Path(folder)))).encode()

    assert decode_json(Outer, data).folder == Path(folder)
    with pytest.raises(RecordError):
        decode_json(Outer, data[:-1])
