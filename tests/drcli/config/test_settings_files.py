"""run.env and system.env, line by line."""

import contextlib
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drcli.base.errors import SettingsError
from drcli.config.editing import with_values
from drcli.config.settings_files import LARGEST_BYTES, content_of, parse_env


@pytest.mark.parametrize(
    ("data", "value"),
    [
        pytest.param(b"A=one two", "one two", id="value-with-a-space"),
        pytest.param(b"A=b=c=d", "b=c=d", id="value-with-equal-signs"),
        pytest.param(b'A="0.23,-1;0.46,1"', "0.23,-1;0.46,1", id="double-quotes"),
        pytest.param(b"A='$B'", "$B", id="single-quotes"),
        pytest.param(b"export A=1", "1", id="export"),
        pytest.param(b"A=1 # once", "1", id="comment-behind"),
        pytest.param(b"A=1#2", "1#2", id="hash-inside"),
        pytest.param(b"\xef\xbb\xbfA=1", "1", id="byte-order-mark"),
        pytest.param(b"\r\n# x\r\nA=1\r\n", "1", id="windows-line-ends"),
        pytest.param(b"A=", "", id="empty"),
        pytest.param(b"A = 1", "1", id="spaces-around-the-equal-sign"),
        pytest.param(b"A=$(touch /tmp/x)", "$(touch /tmp/x)", id="commands-are-only-text"),
        pytest.param("A=Grün".encode(), "Grün", id="beyond-ascii"),
    ],
)
def test_a_value_is_read_as_it_was_meant(data, value):
    file = parse_env(data, "run.env")

    assert [(entry.name, entry.value) for entry in file.entries] == [("A", value)]
    assert file.problems == ()


@pytest.mark.parametrize("data", [b"", b"\n", b"   ", b"# only a comment", b"\xef\xbb\xbf"])
def test_a_file_without_settings_is_fine(data):
    file = parse_env(data, "run.env")

    assert (file.entries, file.problems) == ((), ())


def test_every_entry_knows_its_line():
    file = parse_env(b"# top\r\n\r\nA=1\r\n\r\n  \r\nB='x'\n\nC=3", "run.env")

    assert [str(entry.place) for entry in file.entries] == [
        "run.env line 3",
        "run.env line 6",
        "run.env line 8",
    ]


def test_names_in_single_quotes_are_not_filled_in():
    file = parse_env(b"A='$X'\nB=\"$X\"\nC=$X", "run.env")

    assert [entry.expands for entry in file.entries] == [False, True, True]


@pytest.mark.parametrize(
    ("line", "sentence", "remedy"),
    [
        (b"DR_WORKERS", "run.env line 2: DR_WORKERS has no =.", "Write NAME=value"),
        (b'A="open', 'run.env line 2: A="open is not a NAME=value line.', "close every quote"),
        (b"=5", "run.env line 2: =5 is not a NAME=value line.", "Write NAME=value"),
        (
            b"DR-WORKERS=5",
            "run.env line 2: DR-WORKERS=5 does not start with a variable name.",
            "letters, digits and _",
        ),
        (b"A='1'2", "run.env line 2: A='1'2 is not a NAME=value line.", "close every quote"),
    ],
)
def test_a_broken_line_is_reported_and_the_others_are_read(line, sentence, remedy):
    file = parse_env(b"X=1\n" + line + b"\nY=2\n", "run.env")

    assert [entry.name for entry in file.entries] == ["X", "Y"]
    assert [str(problem) for problem in file.problems] == [sentence]
    assert remedy in file.problems[0].remedy


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"A=1\nB=\xff\xfe\n", "run.env line 2: Byte 0xff is not UTF-8 text."),
        *(
            (
                "A=1\n".encode(code),
                "run.env: The file is UTF-16 text, as PowerShell writes it, and not UTF-8.",
            )
            for code in ("utf-16", "utf-16-le", "utf-16-be")
        ),
        (b"A=1\n\0\n", "run.env line 2: contains a NUL byte, so it is not a text file."),
        (
            b"#" * (LARGEST_BYTES + 1),
            "run.env: The file is 65,537 bytes long; at most 65,536 are allowed.",
        ),
    ],
)
def test_what_is_no_text_is_refused_with_the_place(data, sentence):
    with pytest.raises(SettingsError) as refusal:
        parse_env(data, "run.env")

    assert str(refusal.value) == sentence
    assert "UTF-8" in refusal.value.remedy


@settings(max_examples=50)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data):
    with contextlib.suppress(SettingsError):
        file = parse_env(data, "run.env")

        assert all(entry.place.file == "run.env" for entry in file.entries)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        pytest.param(b"A=1", b"A=2", id="no-line-end"),
        pytest.param(b"A=1  # once\r\nB=3\r\n", b"A=2  # once\r\nB=3\r\n", id="comment-behind"),
        pytest.param(b"A= # nothing yet\n", b"A=2 # nothing yet\n", id="empty-with-comment"),
        pytest.param(b"A=1#2 3\n", b"A=2\n", id="hash-inside"),
        pytest.param(b"export A = 1\n", b"export A = 2\n", id="export-and-spaces"),
        pytest.param(b"A='$B' # x\n", b"A='2' # x\n", id="single-quotes"),
        pytest.param(b'A="a\nb"\nB=1\n', b'A="2"\nB=1\n', id="quotes-over-two-lines"),
        pytest.param(b"A=1\nA=3\n", b"A=1\nA=2\n", id="the-line-that-counts"),
        pytest.param(b"#A=1\n\n", b"#A=1\n\nA=2\n", id="missing"),
        pytest.param(b"B=1\r\nC=1", b"B=1\r\nC=1\r\nA=2\r\n", id="missing-after-an-open-line"),
        pytest.param(b"", b"A=2\n", id="nothing"),
        pytest.param(b"\xef\xbb\xbfA=1\n", b"\xef\xbb\xbfA=2\n", id="byte-order-mark"),
        pytest.param("# Grün\nA=1\n".encode(), "# Grün\nA=2\n".encode(), id="beyond-ascii"),
    ],
)
def test_an_edit_changes_the_value_and_nothing_else(before, after):
    assert with_values(before, {"A": "2"}, "run.env") == after


@given(
    st.lists(
        st.sampled_from(
            ["A=1", "B='x y' # z", 'export C="$A/b"', "# A=5", "", "  ", "A = q  #r", "D=", "B=#"]
        )
    ),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from(["A", "B", "C", "E"]),
)
def test_after_an_edit_every_other_name_reads_as_before(lines, end, name):
    before = end.join(lines).encode()

    after = parse_env(with_values(before, {name: "m-2/$X"}, "run.env"), "run.env")

    values = {entry.name: entry.value for entry in parse_env(before, "run.env").entries}
    assert {entry.name: entry.value for entry in after.entries} == {**values, name: "m-2/$X"}
    assert after.problems == ()


def test_a_named_pipe_in_the_place_of_a_file_is_refused_instead_of_waited_for(tmp_path):
    os.mkfifo(tmp_path / "run.env")

    with pytest.raises(SettingsError, match="not an ordinary file"):
        content_of(tmp_path / "run.env", "run.env")
