"""A racer's file is changed whole or not at all, by one command at a time."""

import errno
import os
import shutil
import stat
from contextlib import nullcontext
from dataclasses import dataclass

import pytest

from drcli.base.errors import SettingsError
from drcli.base.files import load_record, read_json, reserve, rewrite, save_record, write_json


@dataclass(frozen=True)
class Spot:
    """A record."""

    name: str
    row: int


def test_a_file_keeps_its_mode(tmp_path):
    path = tmp_path / "run.env"
    path.write_bytes(b"A=1\n")
    path.chmod(0o640)

    rewrite(path, b"A=2\n")

    assert path.read_bytes() == b"A=2\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path):
    target = tmp_path / "shared.env"
    target.write_bytes(b"A=1\n")
    (tmp_path / "run.env").symlink_to(target)

    rewrite(tmp_path / "run.env", b"A=2\n")

    assert (tmp_path / "run.env").is_symlink()
    assert target.read_bytes() == b"A=2\n"


def test_what_is_no_ordinary_file_is_left_alone(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    (tmp_path / "run.env").symlink_to(pipe)

    with pytest.raises(SettingsError, match="it is not an ordinary file"):
        rewrite(tmp_path / "run.env", b"A=2\n")

    assert pipe.is_fifo()


def test_a_file_that_is_not_there_yet_is_written(tmp_path):
    rewrite(tmp_path / "system.env", b"A=1\n")

    assert (tmp_path / "system.env").read_bytes() == b"A=1\n"


def test_a_write_protected_file_is_left_alone(tmp_path, monkeypatch):
    path = tmp_path / "run.env"
    path.write_bytes(b"A=1\n")
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write everything

    with pytest.raises(SettingsError, match=r"run\.env: cannot be written \(it is write-protected"):
        rewrite(path, b"A=2\n")

    assert path.read_bytes() == b"A=1\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_told_with_what_helps_and_changes_nothing(tmp_path, monkeypatch):
    def refuse(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "run.env"
    path.write_bytes(b"A=1\n")
    monkeypatch.setattr(os, "fsync", refuse)

    with pytest.raises(SettingsError, match="No space left") as caught:
        rewrite(path, b"A=2\n")

    assert caught.value.remedy.startswith("Make room on the disk")
    assert path.read_bytes() == b"A=1\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"gone/run\.env: cannot be written"):
        rewrite(tmp_path / "gone" / "run.env", b"")


@pytest.mark.parametrize("content", [b"", b'{"a": ', b"\xff"], ids=["empty", "half", "binary"])
def test_a_damaged_note_is_none(tmp_path, content):
    (tmp_path / "note.json").write_bytes(content)

    assert read_json(tmp_path / "note.json") is None
    assert read_json(tmp_path / "gone.json") is None


def test_a_note_is_on_the_disk_before_it_takes_the_place_of_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "folder" / "note.json"
    write_json(path, {"a": 1})

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_json(path, {"a": 2})

    assert read_json(path) == {"a": 1}
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(("words", "written"), [("x" * 300, True), ("x" * 9000, False)])
def test_on_a_full_disk_a_record_is_written_where_room_was_reserved(
    tmp_path, monkeypatch, words, written
):
    path = tmp_path / "record.json"
    reserve(path)
    assert load_record(Spot, path) is None

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("drcli.base.files.write_json", full)
    with nullcontext() if written else pytest.raises(OSError, match="No space"):
        save_record(path, Spot(words, 3))

    assert load_record(Spot, path) == (Spot(words, 3) if written else None)


def test_a_note_takes_the_place_of_one_that_belongs_to_somebody_else(tmp_path, monkeypatch):
    path = tmp_path / "note.json"
    write_json(path, {"a": 1})
    path.chmod(0o400)

    def foreign(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(shutil, "copy2", foreign)  # root may read everything
    monkeypatch.setattr(shutil, "chown", foreign)
    write_json(path, {"a": 2})

    assert read_json(path) == {"a": 2}
    assert stat.S_IMODE(path.stat().st_mode) & stat.S_IWUSR
    assert list(tmp_path.iterdir()) == [path]


def test_a_record_comes_back_and_a_damaged_one_is_none(tmp_path):
    path = tmp_path / "folder" / "place.json"
    save_record(path, Spot("hall", 3))

    assert load_record(Spot, path) == Spot("hall", 3)
    path.write_text('{"name": "hall", "row": "three"}')
    assert load_record(Spot, path) is None
    assert load_record(Spot, tmp_path / "gone.json") is None
