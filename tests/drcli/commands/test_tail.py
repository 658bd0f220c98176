"""Reading a log file while somebody writes it."""

import os

from drcli.commands.tail import Tail


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


def _append(path, data):
    with path.open("ab") as file:
        file.write(data)
