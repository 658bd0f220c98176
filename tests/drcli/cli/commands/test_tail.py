"""Reading a log file while somebody writes it."""

import os

from drcli.base import log
from drcli.cli import log_tail as tail_module
from drcli.cli.log_tail import Tail, older


def test_only_the_asked_number_of_old_lines_is_read(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("1\n2\n3\n")

    assert Tail(path, 2).read() == "2\n3\n"
    assert Tail(path, 0).read() == ""
    assert Tail(path).read() == "1\n2\n3\n"


def test_what_was_read_is_not_read_again(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("1\n")
    tail = Tail(path)
    tail.read()

    _append(path, b"2\n")

    assert tail.read() == "2\n"
    assert tail.read() == ""


def test_a_line_waits_for_its_end_even_in_the_middle_of_a_character(tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes("whole\nh\u00e4".encode()[:-1])
    tail = Tail(path)

    first = tail.read()
    _append(path, "\u00e4".encode()[-1:] + b"lf\n")

    assert first == "whole\n"
    assert tail.read() == "h\u00e4lf\n"


def test_a_file_that_comes_late_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "a.log"
    tail = Tail(path, 1)

    before = tail.read()
    path.write_text("1\n2\n3\n")

    assert before == ""
    assert tail.read() == "1\n2\n3\n"


def test_a_file_that_is_replaced_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("a long old line\nand half")
    tail = Tail(path)
    tail.read()

    path.rename(tmp_path / "a.log.1")
    between = tail.read()
    path.write_text("the new file is longer than the old one was\n")

    assert between == ""
    assert tail.read() == "the new file is longer than the old one was\n"


def test_a_file_that_is_emptied_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("old and long\n")
    tail = Tail(path)
    tail.read()

    os.truncate(path, 0)
    _append(path, b"new\n")

    assert tail.read() == "new\n"


def test_no_line_is_lost_where_a_log_is_rotated_between_two_looks(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("1\nha")
    tail = Tail(path)
    first = tail.read()

    _append(path, b"lf\n3\n")
    os.close(log.rotate(path, 1000))
    _append(path, b"4\n")
    _append(path, b"5\n")

    assert first == "1\n"
    assert tail.read() == "half\n3\n4\n5\n"
    assert tail.read() == ""


def test_a_large_log_comes_in_pieces_that_end_with_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr(tail_module, "_MOST_BYTES", 100)
    path = tmp_path / "a.log"
    text = "".join(f"h\u00e4lf {k:03d}\n" for k in range(100)) + "no end " * 40
    path.write_text(text)
    tail = Tail(path)

    pieces = []
    while piece := tail.read(unfinished=True):
        pieces.append(piece)

    assert "".join(pieces) == text
    assert len(pieces) > 10
    assert all(piece.endswith("\n") for piece in pieces[:9])


def test_the_last_lines_of_a_large_log_are_found_from_its_end(tmp_path, monkeypatch):
    monkeypatch.setattr(tail_module, "_BLOCK_BYTES", 10)
    path = tmp_path / "a.log"
    path.write_text("".join(f"line {k}\n" for k in range(50)))

    assert Tail(path, 3).read() == "line 47\nline 48\nline 49\n"
    assert Tail(path, 100).read() == path.read_text()


def test_older_parts_come_first_where_all_of_a_log_is_wanted(tmp_path):
    path = tmp_path / "a.log"
    for k in range(3):
        path.write_text(f"{k}\n")
        os.close(log.rotate(path, 1000))

    assert "".join(older(path)) == "0\n1\n2\n"


def _append(path, data):
    with path.open("ab") as file:
        file.write(data)
