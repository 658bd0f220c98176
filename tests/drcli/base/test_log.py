"""A process's log: times and levels, lines that tools search for, rotation between two records."""

import logging.config
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drcli.base import log
from drcli.base import log as log_files
from drcli.base.log import LogFile, get_logger, plain


@pytest.fixture
def path(tmp_path):
    return tmp_path / "sim-0.log"


@pytest.fixture
def file(path):
    file = LogFile(path, 1 << 20)
    yield file
    file.end()


def test_a_record_has_a_time_in_utc_and_a_level(file, path):
    get_logger("drcli.train.sim").warning("%d cars are lost.", 3)

    time_utc, level, message = path.read_text().split(" ", 2)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", time_utc)
    assert time_utc[:13] in (time.strftime("%Y-%m-%dT%H", time.gmtime(at)) for at in _around())
    assert (level, message) == ("WARNING", "3 cars are lost.\n")


def _around():
    return time.time() - 5.0, time.time()


def test_lines_that_tools_search_for_are_written_as_they_are(file, path):
    plain.info("SIM_TRACE_LOG:0,1\nSIM_TRACE_LOG:0,2")

    assert path.read_text() == "SIM_TRACE_LOG:0,1\nSIM_TRACE_LOG:0,2\n"


def test_a_bug_is_logged_with_its_traceback(file, path):
    try:
        _ = 1 // 0
    except ZeroDivisionError as error:
        get_logger("bug").error("Failed.", exc_info=error)

    assert "ERROR Failed.\nTraceback" in path.read_text()


def test_the_log_goes_on_where_a_reward_function_configures_logging(file, path, capsys):
    before = logging.root.level
    try:
        logging.disable(logging.CRITICAL)
        logging.config.dictConfig({"version": 1})
        get_logger("ours").info("still here")
        logging.warning("the racer's own")
    finally:
        logging.disable(logging.NOTSET)
        logging.root.setLevel(before)

    assert path.read_text().endswith("INFO still here\n")


def test_a_log_that_has_ended_takes_no_more(path, capsys):
    file = LogFile(path, 1 << 20)

    file.end()
    get_logger("ours").info("too late")

    assert path.read_text() == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk to try it on")
def test_a_full_disk_costs_a_record_and_not_the_process(tmp_path, capsys):
    full = tmp_path / "full.log"
    full.symlink_to("/dev/full")
    file = LogFile(full, 1 << 20)
    get_logger("ours").info("lost")
    file.end()

    assert capsys.readouterr().err == ""


def test_a_file_that_is_not_the_log_any_more_is_not_rotated(path):
    file = LogFile(path, 10)
    try:
        path.unlink()
        path.write_text("somebody else's\n" * 100)
        get_logger("ours").info("much longer than ten bytes")
        time_out = time.monotonic() + 5 * log.POLL_S
        while time.monotonic() < time_out:
            assert log_files.older_parts(path) == []
    finally:
        file.end()


WRITER = """
import ctypes, faulthandler, os, sys, time
from pathlib import Path
from drcli.base import log

log.POLL_S = 0.01
sys.stdout.reconfigure(line_buffering=True)
log.LogFile(Path(sys.argv[1]), {max_bytes})
for k in range({lines}):
    if k % 2:
        print(f"{{k:07d}}", "abcdefgh", "ijklmnop")
    else:
        log.plain.info("%07d abcdefgh ijklmnop", k)
    if k % 10 == 0:
        time.sleep(0.001)
print("error", file=sys.stderr)
sys.stdout.flush()
ctypes.CDLL(None).puts(b"from C")
ctypes.CDLL(None).fflush(None)
faulthandler.dump_traceback(file=2)
os.abort()
"""


def test_no_line_is_lost_or_cut_by_rotation_whoever_writes_it_and_however_it_ends(path):
    lines = 4000
    script = WRITER.format(max_bytes=40_000, lines=lines)
    with path.open("ab") as file:
        done = subprocess.run(
            [sys.executable, "-c", script, str(path)],
            stdout=file,
            stderr=file,
            timeout=60,
        )

    assert done.returncode == -6
    parts = [*log_files.older_parts(path), path]
    assert len(parts) >= 2
    texts = [part.read_text() for part in parts]
    assert all(text.endswith("\n") for text in texts[:-1])
    assert sum(map(len, texts)) < 80_000  # 40,000 and what was written between two looks
    numbers = [int(line[:7]) for line in "".join(texts).splitlines() if line[:1] == "0"]
    assert numbers == list(range(numbers[0], lines))
    assert "error\nfrom C\n" in texts[-1]
    assert 'File "<string>"' in texts[-1]


ENDLESS = """
import os, sys, time
from pathlib import Path
from drcli.base import log

log.POLL_S = 0.01
log.LogFile(Path(sys.argv[1]), 200_000)
os.set_blocking(1, True)
while True:
    os.write(1, b"no line ever ends here " * 400)
    time.sleep(0.001)
"""


def test_a_line_without_end_written_past_python_is_rotated_as_well(path):
    with path.open("ab") as file:
        process = subprocess.Popen(
            [sys.executable, "-c", ENDLESS, str(path)],
            stdout=file,
            stderr=file,
        )
    try:
        deadline = time.monotonic() + 60
        while log_files.current_number(path) < 4 and time.monotonic() < deadline:
            time.sleep(0.02)
    finally:
        process.kill()
        process.wait()

    assert log_files.current_number(path) >= 4
    assert len(log_files.older_parts(path)) == 1
