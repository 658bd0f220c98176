"""What the racer's code prints goes into the log of its worker within bounds."""

import io
from threading import Thread

import pytest

from drcli.workers.print_limit import (
    BURST_CHARACTERS,
    CHARACTERS_S,
    TEXT_CHARACTERS,
    LimitedStream,
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


def test_a_stream_limits_only_what_is_printed_while_the_racers_code_runs(limit):
    inner = io.TextIOWrapper(io.BytesIO(), "utf-8")
    stream = LimitedStream(inner, limit)

    limit.active = True
    for _ in range(40_000):
        print(STEP, end="", file=stream)
    limit.active = False
    print("own\n" * 20_000, end="", file=stream)

    printed = inner.buffer.getvalue().decode()
    assert printed.count("own\n") == 20_000
    assert len(printed) <= BURST_CHARACTERS + 80_000 + CHARACTERS_S


def test_threads_of_the_racers_code_are_limited_between_its_calls_too(limit):
    inner = io.TextIOWrapper(io.BytesIO(), "utf-8")
    copied = []
    stream = LimitedStream(inner, limit, [copied.append])

    def print_in_a_thread(text):
        thread = Thread(target=print, args=(text,), kwargs={"file": stream, "end": ""})
        thread.start()
        thread.join()

    print_in_a_thread("of a library\n")
    limit.threads = True
    print("own\n", end="", file=stream)
    print_in_a_thread("theirs\n")
    for _ in range(100):
        print_in_a_thread(200 * STEP)

    assert "".join(copied[:1]) == "theirs\n"
    printed = inner.buffer.getvalue().decode()
    assert printed.startswith("of a library\nown\ntheirs\n")
    assert len(printed) <= BURST_CHARACTERS + CHARACTERS_S


def test_a_line_is_written_at_its_end(limit):
    inner = io.TextIOWrapper(io.BytesIO(), "utf-8")
    stream = LimitedStream(inner, limit)

    print("half", end="", file=stream)
    before = inner.buffer.getvalue()
    print(" and whole", file=stream)

    assert (before, inner.buffer.getvalue()) == (b"", b"half and whole\n")
