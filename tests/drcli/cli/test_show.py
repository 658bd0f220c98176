"""How reports are shown in the width of a terminal."""

import io
from dataclasses import dataclass
from typing import Annotated

from rich.console import Console

from drcli.base.report import BLANK, Col, Curve, Log, bold, table
from drcli.cli.show import drawn


@dataclass(frozen=True)
class Lap:
    driver: Annotated[str, "Who drove.", Col("driver")]
    seconds: Annotated[float | None, "Of the lap.", Col("time", "{:.2f} s")]
    note: Annotated[str, "What was odd.", Col("note", wide=True)] = ""
    seed: Annotated[int, "Not shown."] = 0


@dataclass(frozen=True)
class Report:
    parts: list[object]

    def view(self):
        return self.parts


def screen(*parts, width=40):
    page = io.StringIO()
    Console(file=page, width=width, color_system=None).print(drawn(Report(list(parts))))
    return [line.rstrip() for line in page.getvalue().splitlines()]


LAPS = [Lap("Ann", 7.5, "a long note about the lap"), Lap("Bob", None)]


def test_a_field_with_a_column_is_in_the_table_and_unknown_values_are_dashes():
    assert screen(table(LAPS), width=60) == [
        "driver    time  note",
        "Ann     7.50 s  a long note about the lap",
        "Bob          -",
    ]


def test_a_wide_column_is_left_out_where_it_has_no_room():
    assert screen(table(LAPS)) == ["driver    time", "Ann     7.50 s", "Bob          -"]


def test_a_table_without_room_becomes_a_list():
    laps = [Lap("a driver with a name of 40 letters, or so", 7.5)]

    assert screen(table(laps), width=24) == [
        "a driver with a name of",
        "40 letters, or so",
        "  time 7.50 s",
    ]


def test_fields_can_be_chosen_renamed_and_computed():
    per_km = Col("per km", "{:.0f} s", of=lambda lap: lap.seconds and lap.seconds * 50)

    shown = screen(table(LAPS[:1], "seconds", "driver", per_km, driver="racer"))

    assert shown == ["  time  racer  per km", "7.50 s  Ann     375 s"]


def test_a_column_without_text_and_a_table_without_rows_are_left_out():
    assert screen("before", table(LAPS[1:]), table([]), "after")[1] == "driver  time"
    assert screen("before", table([]), "after") == ["before", "after"]


def test_what_is_false_is_left_out_and_lists_are_indented():
    shown = screen(
        "one", "", None, False, ("two ", bold("words")), ["in", ["deeper"]], BLANK, "end"
    )

    assert shown == ["one", "two words", "  in", "    deeper", "", "end"]


def test_text_is_never_taken_for_a_style():
    assert screen("[bold]", [("[/]", "[red]")]) == ["[bold]", "  [/][red]"]


def test_names_stand_beside_their_values():
    shown = screen({"a": "short", "longer": "some words", "none": ""})

    assert shown == ["a       short", "longer  some words"]


def test_the_long_piece_of_a_line_is_below_where_its_others_are_long():
    shown = screen(Log([("DR_A=1", "# here"), ("DR_LONG=" + "x" * 30, "# there")]))

    assert shown == ["DR_A=1  # here", "DR_LONG=" + "x" * 30, "  # there"]


def test_a_curve_takes_the_room_beside_its_words():
    [line] = screen(Curve("reward", list(range(100)), "0 to 99"), width=30)

    assert len(line) == 30
    assert line.endswith("█  0 to 99")
