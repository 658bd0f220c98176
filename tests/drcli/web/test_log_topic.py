"""Logs on the page: what is added, a log that begins anew, long and damaged ones."""

import json

from drcli.web.run_topics import KEPT_LINES, LONGEST_LINE, MOST_BYTES, LogReader

MISSING = "There is no log yet."


def sent(value, since=None):
    text, marker = value.message(since)
    return (None if text is None else json.loads(text)["data"]), marker


def test_only_what_is_new_is_sent(tmp_path):
    log, reader = tmp_path / "trainer.log", LogReader("log:0:trainer")
    data, marker = sent(reader.read(log, MISSING))
    assert data == {"anew": True, "lines": [], "note": MISSING}
    log.write_text("one\ntwo\nhal")
    data, marker = sent(reader.read(log, MISSING), marker)
    assert data == {"anew": True, "lines": ["one", "two"], "note": ""}
    assert sent(reader.read(log, MISSING), marker)[0] is None
    with log.open("a") as file:
        file.write("f\nfour\n")
    data, marker = sent(reader.read(log, MISSING), marker)
    assert data == {"anew": False, "lines": ["half", "four"], "note": ""}


def test_a_later_page_gets_the_kept_lines_and_a_slow_one_what_is_left(tmp_path):
    log, reader = tmp_path / "a.log", LogReader("log:0:trainer")
    log.write_text("first\n")
    _, marker = sent(reader.read(log, MISSING))
    with log.open("a") as file:
        file.writelines(f"{n}\n" for n in range(2 * KEPT_LINES))
    value = reader.read(log, MISSING)
    assert sent(value)[0]["lines"] == sent(value, marker)[0]["lines"]
    assert len(sent(value)[0]["lines"]) == KEPT_LINES
    assert sent(value)[0]["lines"][-1] == str(2 * KEPT_LINES - 1)


def test_a_log_that_begins_anew_is_shown_anew(tmp_path):
    log, reader = tmp_path / "a.log", LogReader("log:0:trainer")
    log.write_text("old, and longer than the new one\n")
    _, marker = sent(reader.read(log, MISSING))
    log.write_text("new\n")
    data, marker = sent(reader.read(log, MISSING), marker)
    assert (data["anew"], data["lines"]) == (True, ["new"])
    log.unlink()
    data, marker = sent(reader.read(log, MISSING), marker)
    assert data == {"anew": True, "lines": [], "note": MISSING}
    log.write_text("again\n")
    assert sent(reader.read(log, MISSING), marker)[0]["lines"] == ["again"]


def test_of_a_huge_log_only_whole_lines_of_its_end_are_read(tmp_path):
    log, reader = tmp_path / "a.log", LogReader("log:0:trainer")
    log.write_bytes(b"secret-part " * MOST_BYTES + b"end\nlast \xff\n" + b"x" * 2000 + b"\n")
    data, _ = sent(reader.read(log, MISSING))
    assert data["lines"] == ["last \ufffd", "x" * LONGEST_LINE]


def test_a_log_that_cannot_be_read_is_a_sentence(tmp_path):
    data, _ = sent(LogReader("log:0:trainer").read(tmp_path, MISSING))

    assert "cannot be read" in data["note"]
