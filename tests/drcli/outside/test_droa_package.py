"""Folders and archives to import, also those that somebody has crafted."""

import io
import os
import random
import tarfile
import zipfile

import pytest

from drcli.base.errors import SettingsError
from drcli.outside.droa import droa_package
from drcli.outside.droa.droa_package import read_package

FILES = {"model_metadata.json": b"{}", "model/x.index": b"index", ".hidden": b"kept"}


def tar(path, members, mode="w:gz"):
    """An archive of files, or of finished members."""
    with tarfile.open(path, mode) as archive:
        for name, data in members.items():
            member = data if isinstance(data, tarfile.TarInfo) else tarfile.TarInfo(name)
            if member is not data:
                member.size = len(data)
            archive.addfile(member, io.BytesIO(data) if member is not data else None)
    return path


def zipped(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize("folder", ["", "model-1/"])
@pytest.mark.parametrize("ending", ["tar.gz", "tgz", "tar", "tar.xz", "tar.bz2", "zip"])
def test_every_kind_of_archive_gives_the_same_files(tmp_path, ending, folder):
    members = {f"{folder}{name}": data for name, data in FILES.items()}
    path = tmp_path / f"model.{ending}"
    modes = {"tar.gz": "w:gz", "tgz": "w:gz", "tar": "w", "tar.xz": "w:xz", "tar.bz2": "w:bz2"}

    if ending == "zip":
        zipped(path, members)
    else:
        tar(path, members, modes[ending])

    assert read_package(path) == FILES


def test_the_content_decides_not_the_name(tmp_path):
    assert read_package(zipped(tmp_path / "model.tar.gz", FILES)) == FILES


def test_files_that_are_not_wanted_are_left_out(tmp_path):
    others = {"a/x.tar.gz": b"1", "X.ZIP": b"1", "._.DS_Store": b"1", "__MACOSX/model/x": b"1"}

    assert read_package(zipped(tmp_path / "m.zip", FILES | others)) == FILES


@pytest.mark.parametrize("make", [tar, zipped])
def test_damaged_archives_are_refused_in_one_sentence(tmp_path, make):
    path = make(tmp_path / "m", {"model_metadata.json": os.urandom(5000), **FILES})
    whole = path.read_bytes()
    chance = random.Random(1)
    sentences = []
    for _ in range(60):
        data = bytearray(whole[: chance.randrange(1, len(whole) + 1)])
        for _ in range(chance.randrange(3)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data)
        try:
            read_package(path)
        except SettingsError as e:
            sentences.append(str(e))
    assert len(sentences) > 40
    assert not [sentence for sentence in sentences if "\n" in sentence]


@pytest.mark.parametrize("content", [b"", b"PK", b"text", b"\x1f\x8b"])
def test_other_files_are_no_archives(tmp_path, content):
    (tmp_path / "m.tar.gz").write_bytes(content)

    with pytest.raises(SettingsError, match=r"empty|ZIP file|tar archive|truncated"):
        read_package(tmp_path / "m.tar.gz")


def test_what_does_not_exist_or_is_empty_is_said(tmp_path):
    with pytest.raises(SettingsError, match="does not exist"):
        read_package(tmp_path / "nowhere")
    with pytest.raises(SettingsError, match="contains no files"):
        read_package(tmp_path)


def test_something_else_than_a_file_in_a_folder_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")

    with pytest.raises(SettingsError, match="pipe is not a file"):
        read_package(tmp_path)


def test_a_folder_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(droa_package, "MOST_BYTES", 100)
    (tmp_path / "weights").write_bytes(bytes(101))

    with pytest.raises(SettingsError, match="too large"):
        read_package(tmp_path)
