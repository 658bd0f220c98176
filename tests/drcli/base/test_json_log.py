"""The JSON form of a log: one object for each record, with the facts of events."""

import json
import math
import re

import pytest

from drcli.base import log
from drcli.base.log import LONGEST_LINE, JsonLog, get_logger, plain, traces

logger = get_logger("drcli.test")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "sim-0.jsonl"


@pytest.fixture
def file(path):
    file = JsonLog(path, 1 << 20, "sim-0")
    yield file
    file.end()


def records(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_record_has_time_level_process_and_message(file, path):
    logger.warning("%d cars are lost.", 3)

    [record] = records(path)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", record.pop("time"))
    assert record == {"level": "WARNING", "process": "sim-0", "message": "3 cars are lost."}


def test_an_event_has_its_facts_and_numbers_that_json_does_not_know_are_null(file, path):
    log.event(logger, "episode", "100 % of 'x'.", lap=None, reward=math.nan, own=[1.5, math.inf])

    [record] = records(path)
    assert (record["event"], record["message"]) == ("episode", "100 % of 'x'.")
    assert (record["lap"], record["reward"], record["own"]) == (None, None, [1.5, None])


def test_facts_do_not_hide_what_every_record_has(file, path):
    log.event(logger, "episode", "Text.", message="hidden?", level=3, process=4)

    [record] = records(path)
    assert (record["message"], record["level"], record["process"]) == ("Text.", "INFO", "sim-0")


def test_lines_for_tools_are_messages_but_not_those_of_every_step(file, path):
    plain.info("Policy training> Entropy=1.0")
    traces.info("SIM_TRACE_LOG:0,1\nSIM_TRACE_LOG:0,2")
    plain.info("\n")

    assert [record["message"] for record in records(path)] == ["Policy training> Entropy=1.0"]


def test_a_failure_is_one_record_with_its_traceback(file, path):
    try:
        _ = 1 // 0
    except ZeroDivisionError as error:
        logger.error("Failed.", exc_info=error)

    [record] = records(path)
    assert record["message"].startswith("Failed.\nTraceback")
    assert record["message"].endswith("ZeroDivisionError: integer division or modulo by zero")


def test_prints_are_records_line_by_line(file, path):
    for piece in ("reward ", "1.5", "\n", "\n", "two\nthree"):
        file.printed(piece)
    file.end()

    found = records(path)
    assert [record["message"] for record in found] == ["reward 1.5", "two", "three"]
    assert {record["event"] for record in found} == {"print"}


def test_prints_without_an_end_of_line_do_not_wait_in_memory_for_ever(file, path):
    for _ in range(LONGEST_LINE // 1000 + 1):
        file.printed(1000 * ".")

    [record] = records(path)
    assert len(record["message"]) > LONGEST_LINE
