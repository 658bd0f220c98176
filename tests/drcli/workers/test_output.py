"""What a worker prints: within bounds, into a log that is rotated between two lines."""

import os
import subprocess
import sys
import time

import pytest

from drcli.base import log_files
from drcli.workers.output import (
    BURST_CHARACTERS,
    CHARACTERS_S,
    TEXT_CHARACTERS,
    Output,
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


def test_what_people_print_at_each_step_goes_into_the_log_whole(clock):
    allowance = PrintLimit(clock)

    for _ in range(60):
        clock.now_s += 1.0
        admitted = "".join(allowance.admit(STEP) for _ in range(500))
        assert admitted == 500 * STEP


def test_a_flood_is_cut_and_the_log_says_how_much_is_missing(clock):
    allowance = PrintLimit(clock)
    printed = 0
    log = ""

    for _ in range(600):
        clock.now_s += 0.1
        log += allowance.admit("y" * 1_000_000) + allowance.admit("\n")
        printed += 1_000_000
    log += allowance.summary()

    assert len(log) < BURST_CHARACTERS + 60 * CHARACTERS_S + 10_000
    assert "Prints> The reward function prints too much." in log
    assert "prints of the reward function with" in log
    left_out = sum(
        float(line.split(" MB were")[0].rsplit(" ", 1)[1].replace(",", ""))
        for line in log.splitlines()
        if " MB were left out" in line
    )
    shortened = log.count("more characters are left out")
    assert left_out + shortened == pytest.approx(600, rel=0.02)  # MB, one each print
    assert all(line[:1] in "yP" for line in log.splitlines())  # each note has a line of its own


def test_a_single_long_text_keeps_its_beginning_and_the_end_of_its_line(clock):
    text = PrintLimit(clock).admit("z" * (TEXT_CHARACTERS + 5) + "\n")

    assert text == "z" * TEXT_CHARACTERS + " ... (6 more characters are left out)\n"


def test_nothing_is_said_where_nothing_is_missing(clock):
    allowance = PrintLimit(clock)

    allowance.admit(STEP)

    assert allowance.summary() == ""


def test_our_own_prints_have_no_limit_and_come_after_what_was_left_out(clock, tmp_path):
    path = tmp_path / "log"
    output = Output(PrintLimit(clock))
    with path.open("w") as inner:
        stream = output.stream(inner)
        output.limited = True
        for _ in range(40_000):
            stream.write(STEP)
        output.end_limit()
        for _ in range(20_000):
            stream.write("own\n")

    lines = path.read_text().splitlines()
    assert lines[-20_000:] == ["own"] * 20_000
    assert "were left out" in lines[-20_001]


WRITER = """
import ctypes, faulthandler, os, sys, time
from drcli.workers import output

output.LOOK_S = 0.01
output.install({max_bytes})
for k in range({lines}):
    print(f"{{k:07d}}", "abcdefgh", "ijklmnop")
    if k % 10 == 0:
        time.sleep(0.001)
print("error", file=sys.stderr)
sys.stdout.flush()
ctypes.CDLL(None).puts(b"from C")
ctypes.CDLL(None).fflush(None)
faulthandler.dump_traceback(file=2)
os.abort()
"""


def test_no_line_is_lost_or_cut_by_rotation_whoever_writes_it_and_however_it_ends(tmp_path):
    log, lines = tmp_path / "sim-0.log", 4000
    script = WRITER.format(max_bytes=40_000, lines=lines)
    with log.open("ab") as file:
        done = subprocess.run(
            [sys.executable, "-c", script],
            stdout=file,
            stderr=file,
            env={**os.environ, log_files.VARIABLE: str(log)},
            timeout=60,
        )

    assert done.returncode == -6
    parts = [*log_files.older_parts(log), log]
    assert len(parts) >= 2
    texts = [path.read_text() for path in parts]
    assert all(text.endswith("\n") for text in texts[:-1])
    assert sum(map(len, texts)) < 80_000  # 40,000 and what was written between two looks
    numbers = [int(line[:7]) for line in "".join(texts).splitlines() if line[:1] == "0"]
    assert numbers == list(range(numbers[0], lines))
    assert "error\nfrom C\n" in texts[-1]
    assert 'File "<string>"' in texts[-1]


ENDLESS = """
import os, time
from drcli.workers import output

output.LOOK_S = 0.01
output.install(200_000)
os.set_blocking(1, True)
while True:
    os.write(1, b"no line ever ends here " * 400)
    time.sleep(0.001)
"""


def test_a_line_without_end_written_past_python_is_rotated_as_well(tmp_path):
    log = tmp_path / "sim-0.log"
    with log.open("ab") as file:
        process = subprocess.Popen(
            [sys.executable, "-c", ENDLESS],
            stdout=file,
            stderr=file,
            env={**os.environ, log_files.VARIABLE: str(log)},
        )
    try:
        deadline = time.monotonic() + 60
        while log_files.current_number(log) < 4 and time.monotonic() < deadline:
            time.sleep(0.02)
    finally:
        process.kill()
        process.wait()

    assert log_files.current_number(log) >= 4
    assert len(log_files.older_parts(log)) == 1


def test_a_process_whose_output_is_elsewhere_rotates_nothing(tmp_path):
    log = tmp_path / "sim-0.log"
    log.write_text("somebody else's\n" * 100)
    output = Output(PrintLimit())

    assert not output.rotate_if_large(log, 10)
    assert log_files.older_parts(log) == []
