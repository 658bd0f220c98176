"""No file of a user is replaced unless that is asked for."""

import errno
import os
import tempfile

import pytest

from drcli.base.errors import SettingsError
from drcli.base.files import refuse_replacing, safe_name


def test_a_file_is_replaced_only_with_force(tmp_path):
    own = tmp_path / "own"
    own.write_bytes(b"mine")

    with pytest.raises(SettingsError, match="own exists already") as caught:
        refuse_replacing(own, force=False)

    assert "-f (--force)" in caught.value.remedy
    refuse_replacing(own, force=True)
    refuse_replacing(tmp_path / "none", force=False)
    assert own.read_bytes() == b"mine"


def test_names_of_files_tell_models_apart_and_need_no_quotes():
    assert safe_name("anna/m1") != safe_name("ben/m1")
    assert safe_name("anna/m 1") == "anna-m-1"


def test_a_missing_folder_is_reported_before_anything_is_made(tmp_path):
    with pytest.raises(SettingsError, match="does not exist"):
        refuse_replacing(tmp_path / "nowhere" / "reward.png", force=True)


def test_neither_a_folder_nor_a_named_pipe_is_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")

    for path in (tmp_path, tmp_path / "pipe"):
        with pytest.raises(SettingsError, match=r"cannot be written: it is"):
            refuse_replacing(path, force=True)


def test_a_folder_that_takes_no_files_is_reported_before_anything_is_made(tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(tempfile, "NamedTemporaryFile", full)

    with pytest.raises(SettingsError, match="cannot be written: Read-only file system"):
        refuse_replacing(tmp_path / "reward.png", force=False)


def test_looking_leaves_nothing_behind(tmp_path):
    refuse_replacing(tmp_path / "lap.mp4", force=False)

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("length", [250, 300])
def test_a_name_that_is_too_long_is_reported_before_anything_is_made(tmp_path, length):
    with pytest.raises(SettingsError, match="cannot be written: File name too long"):
        refuse_replacing(tmp_path / f"{length * 'x'}.mp4", force=False)
