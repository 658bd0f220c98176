"""A picture, a page or a video replaces only files of its own kind."""

import errno
import os
import tempfile

import pytest

from drcli.base.errors import SettingsError
from drcli.base.replaceable import HTML_PAGE, PNG_PICTURE, VIDEO, refuse_replacing

KINDS = {"PNG": PNG_PICTURE, "HTML": HTML_PAGE, "video": VIDEO}


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("PNG", b"\x89PNG\r\n\x1a\n\x00\x00"),
        ("HTML", b"<!DOCTYPE html>\n<html>"),
        ("HTML", b"\xef\xbb\xbf \n<!-- saved -->\n<HTML lang='en'>"),
        ("video", b"\x00\x00\x00\x0aftypisom"),
        ("video", b"GIF89a\x01"),
        *((kind, b"") for kind in KINDS),
    ],
)
def test_a_file_of_the_same_kind_or_an_empty_one_may_be_replaced(tmp_path, kind, content):
    (tmp_path / "old").write_bytes(content)

    refuse_replacing(tmp_path / "old", KINDS[kind])
    refuse_replacing(tmp_path / "none", KINDS[kind])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "content",
    [b"DR_WORKERS=1\n", b"%PDF-1.7", b"\x00\x01", b"# ftyp, GIF8, <html> and \x89PNG\r\n\x1a\n"],
)
def test_a_file_of_another_kind_is_not_replaced(tmp_path, kind, content):
    own = tmp_path / "own"
    own.write_bytes(content)

    with pytest.raises(SettingsError, match=f"exists and is not an? {kind}") as caught:
        refuse_replacing(own, KINDS[kind])

    assert f"such as {KINDS[kind].example}." in caught.value.remedy
    assert own.read_bytes() == content


def test_a_missing_folder_is_reported_before_anything_is_made(tmp_path):
    with pytest.raises(SettingsError, match="does not exist"):
        refuse_replacing(tmp_path / "nowhere" / "reward.png")


def test_neither_a_folder_nor_a_named_pipe_is_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")

    for path in (tmp_path, tmp_path / "pipe"):
        with pytest.raises(SettingsError, match=r"cannot be written: (Is|It is)"):
            refuse_replacing(path, HTML_PAGE)


def test_a_folder_that_takes_no_files_is_reported_before_anything_is_made(tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(tempfile, "NamedTemporaryFile", full)

    with pytest.raises(SettingsError, match="cannot be written: Read-only file system"):
        refuse_replacing(tmp_path / "reward.png")


def test_looking_leaves_nothing_behind(tmp_path):
    refuse_replacing(tmp_path / "lap.mp4", VIDEO)

    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_too_long_is_reported_before_anything_is_made(tmp_path):
    with pytest.raises(SettingsError, match="cannot be written: File name too long"):
        refuse_replacing(tmp_path / f"{250 * 'x'}.mp4", VIDEO)
