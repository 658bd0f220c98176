"""A file of limited size: whole lines, nothing lost, no failure on a full disk."""

import threading

import pytest

from drcli.base import log
from drcli.base.log import RotatingFile


@pytest.fixture
def path(tmp_path):
    return tmp_path / "reward" / "reward-0.log"


def everything(path):
    return "".join(part.read_text() for part in [*log.older_parts(path), path])


def test_there_is_no_file_before_the_first_line(path):
    file = RotatingFile(path, 1 << 20)
    file.write("no end yet")
    assert not path.exists()

    file.write(", but now\n")
    file.close()

    assert path.read_text() == "no end yet, but now\n"


def test_an_unfinished_line_is_written_at_the_end(path):
    file = RotatingFile(path, 1 << 20)
    file.write("one\ntwo")

    file.close()

    assert path.read_text() == "one\ntwo\n"


def test_a_line_without_an_end_does_not_grow_in_memory_for_ever(path):
    file = RotatingFile(path, 1 << 30)

    file.write("x" * 200_000)

    assert path.stat().st_size == 200_000


def test_the_oldest_lines_go_when_the_limit_is_reached(path):
    file = RotatingFile(path, 20_000)

    for k in range(5000):
        file.write(f"line {k:06d}\n")
    file.close()

    kept = everything(path).splitlines()
    assert sum(len(line) + 1 for line in kept) < 31_000
    assert kept == [f"line {k:06d}" for k in range(5000 - len(kept), 5000)]


def test_several_writers_may_share_a_file(path):
    def write(name):
        file = RotatingFile(path, 1 << 20)
        for k in range(300):
            file.write(f"{name} {k}\n")
        file.close()

    writers = [threading.Thread(target=write, args=(name,)) for name in "ab"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()

    lines = everything(path).splitlines()
    assert [line for line in lines if line[0] == "a"] == [f"a {k}" for k in range(300)]
    assert len(lines) == 600


def test_a_file_that_somebody_moved_away_begins_again(path):
    file = RotatingFile(path, 1 << 20)
    file.write("old\n")
    path.rename(path.with_name("aside"))

    file.write("new\n")

    assert path.read_text() == "new\n"


def test_a_folder_that_cannot_be_made_costs_the_lines_only(tmp_path):
    (tmp_path / "reward").write_text("a file")

    file = RotatingFile(tmp_path / "reward" / "reward-0.log", 1 << 20)
    file.write("lost\n")
    file.close()

    assert (tmp_path / "reward").read_text() == "a file"
