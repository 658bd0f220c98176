"""What a client gets of the values of topics."""

import json
import math
from dataclasses import dataclass

import pytest

from drcli.web.topics import Picture, Rows, Snapshot


@dataclass(frozen=True)
class Row:
    """A row of a list."""

    iteration: int
    reward: float


def data_of(message):
    return json.loads(message)["data"]


def follow(rows, since, held):
    """What a page has after the next message, and its marker."""
    message, marker = rows.message(since)
    if message is None:
        return held, marker
    data = data_of(message)
    return held[: data["start"]] + data["rows"], marker


def test_a_snapshot_is_sent_once():
    value = Snapshot.of("t", {"a": 1})
    message, marker = value.message(None)

    assert json.loads(message) == {"topic": "t", "data": {"a": 1}}
    assert Snapshot.of("t", {"a": 1}).message(marker)[0] is None
    assert Snapshot.of("t", {"a": 2}).message(marker)[0] is not None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_that_json_does_not_have_become_null(value):
    message, _ = Snapshot.of("t", {"a": [value]}).message(None)

    assert data_of(message) == {"a": [None]}


def test_rows_that_were_added_are_sent_alone():
    rows = Rows("t")
    rows.update([Row(0, 1.0)])
    held, marker = follow(rows, None, [])
    rows.update([Row(0, 1.0), Row(1, 2.0), Row(2, 3.0)])

    message, _ = rows.message(marker)

    assert data_of(message)["start"] == 1
    assert [row["iteration"] for row in data_of(message)["rows"]] == [1, 2]
    assert len(held) == 1


def test_a_row_that_changes_is_sent_again_with_those_after_it_only():
    rows = Rows("t")
    rows.update([Row(k, 1.0) for k in range(500)])
    _, marker = rows.message(None)
    rows.update([*(Row(k, 1.0) for k in range(499)), Row(499, 2.0), Row(500, 3.0)])

    data = data_of(rows.message(marker)[0])
    assert data["start"] == 499
    assert [row["reward"] for row in data["rows"]] == [2.0, 3.0]
    rows.update([])
    assert data_of(rows.message(marker)[0]) == {"start": 0, "rows": []}


def test_unchanged_rows_are_not_sent_even_with_nan():
    rows = Rows("t")
    rows.update([Row(0, math.nan)])
    _, marker = rows.message(None)
    rows.update([Row(0, math.nan)])

    assert rows.message(marker)[0] is None


@pytest.mark.parametrize(
    "then",
    [
        [],
        [Row(0, 1.0)],
        [Row(0, 9.0), Row(1, 2.0)],
        [Row(0, 9.0), Row(1, 2.0), Row(2, 3.0)],
        [Row(5, 1.0)],
    ],
)
def test_a_page_always_ends_with_the_list_of_now(then):
    rows = Rows("t")
    rows.update([Row(0, 1.0), Row(1, 2.0)])
    held, marker = follow(rows, None, [])
    rows.update(then)
    held, marker = follow(rows, marker, held)
    rows.update([*then, Row(7, 7.0)])
    held, marker = follow(rows, marker, held)

    assert [row["reward"] for row in held] == [*(row.reward for row in then), 7.0]
    assert rows.message(marker)[0] is None


def test_a_picture_has_its_facts_before_it_and_is_sent_once():
    picture = Picture("live:0", b"\xff\xd8jpeg", {"step_s": 1.5, "width": 320})
    message, marker = picture.message(None)
    length = int.from_bytes(message[:2], "big")

    assert json.loads(message[2 : 2 + length]) == {"topic": "live:0", "step_s": 1.5, "width": 320}
    assert message[2 + length :] == b"\xff\xd8jpeg"
    assert picture.message(marker)[0] is None
    assert Picture("live:0", b"\xff\xd8jpeg", {}).message(marker)[0] is not None
