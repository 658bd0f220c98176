"""Folders and archives to import, also those that somebody has crafted."""

import io
import os
import random
import stat
import tarfile
import zipfile

import pytest

from drcli.base.errors import SettingsError
from drcli.remote import droa_package
from drcli.remote.droa_package import read_package

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


def special(name, kind, target=""):
    member = tarfile.TarInfo(name)
    member.type = kind
    member.linkname = target
    return member


@pytest.mark.parametrize("folder", ["", "model-1/"])
@pytest.mark.parametrize("ending", ["tar.gz", "tgz", "tar", "tar.xz", "zip"])
def test_every_kind_of_archive_gives_the_same_files(tmp_path, ending, folder):
    members = {f"{folder}{name}": data for name, data in FILES.items()}
    path = tmp_path / f"model.{ending}"
    modes = {"tar.gz": "w:gz", "tgz": "w:gz", "tar": "w", "tar.xz": "w:xz"}

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


@pytest.mark.parametrize(
    "name", ["../out", "/etc/passwd", "a/../../b", "C:\\x", "..\\x", "a\x1bb", "a\nb"]
)
def test_names_that_lead_elsewhere_are_refused(tmp_path, name):
    with pytest.raises(SettingsError, match="is not a name inside the archive"):
        read_package(tar(tmp_path / "m.tar", {**FILES, name: b"x"}, "w"))


@pytest.mark.parametrize(
    "kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE]
)
def test_links_and_devices_are_refused(tmp_path, kind):
    members = {**FILES, "x": special("x", kind, "/etc/passwd")}

    with pytest.raises(SettingsError, match="x is a link or a device"):
        read_package(tar(tmp_path / "m.tar", members, "w"))


def test_links_in_zip_archives_are_refused(tmp_path):
    link = zipfile.ZipInfo("x")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16

    with pytest.raises(SettingsError, match="x is a link or a device"):
        read_package(zipped(tmp_path / "m.zip", {link: b"/etc/passwd"}))


@pytest.mark.parametrize("make", [tar, zipped])
def test_bombs_are_refused_before_they_fill_the_memory(tmp_path, monkeypatch, make):
    monkeypatch.setattr(droa_package, "MOST_BYTES", 1 << 20)

    path = make(tmp_path / "m", {"model_metadata.json": bytes(4 << 20)})

    assert path.stat().st_size < 10_000
    with pytest.raises(SettingsError, match="too large"):
        read_package(path)


def test_archives_of_very_many_files_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(droa_package, "_LARGEST_ARCHIVE_FILES", 10)

    with pytest.raises(SettingsError, match="more than 10 files"):
        read_package(tar(tmp_path / "m.tar", {str(n): b"" for n in range(11)}, "w"))


def test_a_file_twice_is_refused(tmp_path):
    path = tar(tmp_path / "m.tar", FILES, "w")
    with tarfile.open(path, "a") as archive:
        archive.addfile(tarfile.TarInfo("model_metadata.json"))

    with pytest.raises(SettingsError, match="twice"):
        read_package(path)


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

    with pytest.raises(SettingsError, match="cannot be imported"):
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
