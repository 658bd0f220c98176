"""Reading files that people name: pipes and devices are refused instead of waited for."""

import os
from pathlib import Path

import pytest

from drcli.base.files import read_regular


def test_a_file_and_a_link_to_it_are_read(tmp_path):
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to("file")

    assert read_regular(tmp_path / "link") == b"content"


def test_a_named_pipe_that_nobody_writes_to_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")

    with pytest.raises(OSError, match="not an ordinary file"):
        read_regular(tmp_path / "pipe")


@pytest.mark.parametrize("path", ["/dev/zero", "."])
def test_devices_without_an_end_and_folders_are_refused(path):
    with pytest.raises(OSError, match=r"not an ordinary file|Is a directory"):
        read_regular(Path(path))


def test_what_is_missing_is_said_to_be_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_regular(tmp_path / "missing")
