"""The car's rules for archives, before anything is sent; the rules themselves have other tests."""

import gzip
import io
import os
import tarfile

import pytest

from drcli.base.archive import read_archive, unpack_archive
from drcli.base.errors import SettingsError
from drcli.outside.car.car_models import check_file
from fake_car import archive, graph


def test_a_good_archive_names_model_and_sensors(tmp_path):
    found = check_file(archive(tmp_path / "fast-car_1.tar.gz"))

    assert (found.name, found.sensors) == ("fast-car_1", ("FRONT_FACING_CAMERA",))


def test_folders_text_files_and_a_dot_before_names_are_no_matter(tmp_path):
    files = {"./agent/model.pb": graph("m"), "agent/model.pb": None, "ip/readme.txt": b"x"}

    assert check_file(archive(tmp_path / "m.tar.gz", files=files)).name == "m"


def test_files_that_macos_adds_are_not_sent_to_the_car(tmp_path):
    files = {"agent/._model.pb": b"\0\5\x16\7", ".DS_Store": b"Bud1"}

    found = check_file(archive(tmp_path / "m.tar.gz", files=files))

    sent = unpack_archive(io.BytesIO(found.content), "sent", wanted=lambda _: True)
    assert sent == read_archive(tmp_path / "m.tar.gz")  # which leaves them out
    assert sent.keys() == {"agent/model.pb", "model_metadata.json"}


@pytest.mark.parametrize(
    "name", ["model.zip", "model.tar", "my model.tar.gz", "v1.2.tar.gz", ".tar.gz"]
)
def test_a_name_that_the_car_would_change_is_refused(tmp_path, name):
    with pytest.raises(SettingsError, match="name that the car keeps"):
        check_file(archive(tmp_path / name))


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        ({"agent/model.pb": None}, "contains 0 files that end in .pb"),
        ({"old/model.pb": b"x"}, "contains 2 files that end in .pb"),
        ({"agent/model.pb": b""}, "agent/model.pb"),
        ({"model/.coach_checkpoint": b"x"}, "takes model/.coach_checkpoint for a second model"),
        ({"model_metadata.json": None}, "no model_metadata.json"),
        ({"model_metadata.json": b"[" * 100_000}, "cannot read it"),
        ({"../evil.txt": b"x"}, "evil.txt"),
        ({"model_metadata.json": b'{"action_space": [1]}'}, "action_space"),
    ],
)
def test_content_that_the_car_refuses_is_named(tmp_path, files, sentence):
    with pytest.raises(SettingsError) as refusal:
        check_file(archive(tmp_path / "m.tar.gz", files=files))

    assert sentence in str(refusal.value)


def test_a_file_that_is_no_archive_or_not_whole_is_refused(tmp_path):
    path = archive(tmp_path / "m.tar.gz", files={"notes.txt": os.urandom(100_000)})
    whole = path.read_bytes()

    for content in (b"", b"text", gzip.compress(b"no tar"), whole[:50_000], whole[:20], whole[30:]):
        path.write_bytes(content)
        with pytest.raises(SettingsError):
            check_file(path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "m.tar.gz"
    with gzip.open(path, "wb", 1) as out:
        info = tarfile.TarInfo("agent/model.pb")
        info.size = 2 << 30
        out.write(info.tobuf())

    with pytest.raises(SettingsError):
        check_file(path)


def test_a_file_that_is_not_there_or_a_folder_is_a_sentence(tmp_path):
    (tmp_path / "folder.tar.gz").mkdir()

    for name in ("none.tar.gz", "folder.tar.gz"):
        with pytest.raises(SettingsError, match=r"cannot be read|not an ordinary file"):
            check_file(tmp_path / name)
