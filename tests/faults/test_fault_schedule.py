"""Schedules as text, by chance, and shortened."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fault_kinds import _FAULTS as IMPLEMENTED
from fault_schedule import KINDS, NETWORK, Fault, parse, random_schedule, text_of
from fault_shrink import shrink

pytestmark = pytest.mark.nightly


@given(st.integers(0, 10_000), st.integers(0, 60))
def test_a_schedule_is_read_as_it_was_printed(seed, faults):
    schedule = random_schedule(seed, faults)

    assert parse(text_of(schedule)) == schedule
    assert len(schedule) == faults


def test_equal_seeds_give_equal_schedules_and_others_give_others():
    assert random_schedule(1, 30) == random_schedule(1, 30)
    assert random_schedule(1, 30) != random_schedule(2, 30)


@given(st.integers(0, 10_000))
def test_every_kind_comes_in_its_order_and_never_where_it_has_no_place(seed):
    schedule = random_schedule(seed, 60)

    assert {fault.kind for fault in schedule} == set(KINDS) == set(IMPLEMENTED)
    assert [fault.after for fault in schedule] == sorted(fault.after for fault in schedule)
    remote = True
    for fault in schedule:
        assert remote or fault.kind not in NETWORK
        if fault.kind == "gone":
            remote = fault.values["cloud"] == "remote"


def test_notes_in_a_schedule_are_left_out():
    text = "# why it failed\n\n3 kill process=sim-0\n  4 slow latency_s=0.5 for_s=2\n"

    assert parse(text) == [
        Fault(3, "kill", {"process": "sim-0"}),
        Fault(4, "slow", {"latency_s": 0.5, "for_s": 2}),
    ]


@pytest.mark.parametrize("line", ["kill process=sim-0", "3 explode", "3 kill process", "x"])
def test_a_line_that_is_no_fault_is_named(line):
    with pytest.raises(ValueError, match=r"Line 2 is no fault"):
        parse(f"1 terminate\n{line}")


@given(st.lists(st.integers(0, 50), unique=True, min_size=1), st.data())
def test_a_failing_schedule_shrinks_to_what_makes_it_fail(items, data):
    needed = data.draw(st.lists(st.sampled_from(items), unique=True, min_size=1, max_size=3))
    asked = []

    def fails(some: list[int]) -> bool:
        asked.append(some)
        return set(needed) <= set(some)

    assert shrink(items, fails) == [item for item in items if item in needed]
    assert len(asked) <= len(items) ** 2 + 2 * len(items)
