"""Log files end: older parts, and the logs of earlier trainings."""

import os

import pytest

from drcli.base import log as log_files

MAX_BYTES = 100


def _rotated(log, text):
    log.write_text(text)
    os.close(log_files.rotate(log, MAX_BYTES))


def _names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_log_that_is_rotated_begins_anew_and_keeps_its_older_part(tmp_path):
    log = tmp_path / "sim-0.log"
    log.write_text("old\n")

    descriptor = log_files.rotate(log, MAX_BYTES)
    os.write(descriptor, b"new\n")
    os.close(descriptor)

    assert log.read_text() == "new\n"
    assert [part.read_text() for part in log_files.older_parts(log)] == ["old\n"]
    assert _names(tmp_path) == ["sim-0.log", "sim-0.log.part-0001"]


def test_the_oldest_parts_go_where_a_log_grows_too_large(tmp_path):
    log = tmp_path / "sim-0.log"

    for k in range(12):
        _rotated(log, "abcdefghijkl"[k] * 20)

    parts = log_files.older_parts(log)
    assert [part.read_text()[0] for part in parts] == ["k", "l"]
    assert [log_files.number_of(part) for part in parts] == [11, 12]
    assert log_files.current_number(log) == 13


def test_one_part_that_is_too_large_for_itself_goes_with_the_next_one(tmp_path):
    log = tmp_path / "sim-0.log"

    _rotated(log, "x" * 1000)
    _rotated(log, "y")

    assert [part.read_text() for part in log_files.older_parts(log)] == ["y"]


def test_parts_are_counted_beyond_four_digits(tmp_path):
    for number in (9999, 10_000):
        (tmp_path / f"sim-0.log.part-{number:04d}").touch()

    assert log_files.current_number(tmp_path / "sim-0.log") == 10_001


def test_where_no_new_file_can_be_made_the_log_stays_as_it_is(tmp_path):
    log = tmp_path / "sim-0.log"
    log.write_text("all of it\n")
    (tmp_path / "sim-0.log.new").mkdir()

    with pytest.raises(OSError, match="sim-0"):
        log_files.rotate(log, MAX_BYTES)

    assert log.read_text() == "all of it\n"
    assert log_files.older_parts(log) == []


def test_a_new_training_finds_no_log_of_the_one_before_and_that_one_is_kept(tmp_path):
    for name in ("sim-0.log", "sim-0.log.part-0001", "sim-0.log.uploaded", "evaluation.log"):
        (tmp_path / name).write_text(name)

    log_files.set_aside([tmp_path, tmp_path / "there is no such folder"], MAX_BYTES)

    *kept, old, part = _names(tmp_path)
    assert kept == ["evaluation.log"]
    assert old.startswith("sim-0.log.2")
    assert part == f"{old}.part-0001"
    assert (tmp_path / part).read_text() == "sim-0.log.part-0001"
    assert not list(tmp_path.glob("sim*.log"))


def test_logs_of_so_many_earlier_trainings_are_kept_even_of_one_second(tmp_path):
    for k in range(log_files.EARLIER_TRAININGS + 3):
        (tmp_path / "trainer.log").write_text(f"{k}")
        (tmp_path / "supervisor.log").write_text(f"{k}")
        log_files.set_aside([tmp_path], MAX_BYTES)

    assert len(_names(tmp_path)) == 2 * log_files.EARLIER_TRAININGS
    texts = {path.read_text() for path in tmp_path.iterdir()}
    assert texts == {f"{k}" for k in range(3, log_files.EARLIER_TRAININGS + 3)}


def test_large_logs_of_earlier_trainings_go_but_for_the_last(tmp_path):
    for k in range(3):
        (tmp_path / "trainer.log").write_text(f"{k}" * 2 * MAX_BYTES)
        log_files.set_aside([tmp_path], MAX_BYTES)

    [kept] = tmp_path.iterdir()
    assert kept.read_text()[0] == "2"


def test_logs_of_a_training_after_the_clock_was_set_back_are_still_the_newest(tmp_path):
    (tmp_path / "sim-0.log.20990101-000000").write_text("earlier")
    (tmp_path / "sim-0.log").write_text("newest")

    log_files.set_aside([tmp_path], 1 << 20)

    assert (tmp_path / "sim-0.log.20990101-000001").read_text() == "newest"
