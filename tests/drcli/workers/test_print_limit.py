"""What the racer's code prints goes into the log of its worker within bounds."""

import pytest

from drcli.workers.print_limit import (
    BURST_CHARACTERS,
    CHARACTERS_S,
    TEXT_CHARACTERS,
    PrintLimit,
)

STEP = "x" * 99 + "\n"


class Clock:
    """Seconds that a test lets pass."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def warnings():
    return []


@pytest.fixture
def limit(clock, warnings):
    return PrintLimit(warnings.append, clock)


def test_what_people_print_at_each_step_goes_into_the_log_whole(limit, clock):
    for _ in range(60):
        clock.now_s += 1.0
        admitted = "".join(limit.admit(STEP) for _ in range(500))
        assert admitted == 500 * STEP


def test_a_flood_is_cut_and_the_log_says_how_much_is_missing(limit, clock, warnings):
    admitted = ""

    for _ in range(600):
        clock.now_s += 0.1
        admitted += limit.admit("y" * 1_000_000) + limit.admit("\n")
    limit.report()

    assert len(admitted) < BURST_CHARACTERS + 60 * CHARACTERS_S + 10_000
    assert warnings[0].startswith("The reward function prints too much.")
    left_out_mb = sum(
        float(line.split(" MB)")[0].rsplit("(", 1)[1].replace(",", ""))
        for line in warnings
        if "were left out" in line
    )
    shortened = admitted.count("more characters are left out")
    assert left_out_mb + shortened == pytest.approx(600, rel=0.02)  # each print has one MB


def test_a_single_long_text_keeps_its_beginning_and_the_end_of_its_line(limit):
    text = limit.admit("z" * (TEXT_CHARACTERS + 5) + "\n")

    assert text == "z" * TEXT_CHARACTERS + " ... (6 more characters are left out)\n"


def test_nothing_is_said_where_nothing_is_missing(limit, warnings):
    limit.admit(STEP)
    limit.report()

    assert warnings == []


def test_copies_get_what_the_limit_admits_of_what_is_printed(limit, monkeypatch, capsys):
    copied = []
    monkeypatch.setattr(limit, "copies", [copied.append])

    for _ in range(40_000):
        limit.write(STEP)
    print("own\n" * 20_000, end="")

    printed = capsys.readouterr().out
    theirs = printed.replace("own\n", "")
    assert printed.count("own\n") == 20_000
    assert len(theirs) <= BURST_CHARACTERS
    assert "".join(copied) == theirs
    assert theirs.startswith(100 * STEP)
