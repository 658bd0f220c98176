"""The car's rules for archives, before anything is sent."""

import gzip
import io
import os
import tarfile

import pytest

from drcli.base.errors import SettingsError
from drcli.remote.car_file import check_file
from fake_car import archive


def test_a_good_archive_names_model_and_sensors(tmp_path):
    found = check_file(archive(tmp_path / "fast-car_1.tar.gz"))

    assert (found.name, found.sensors) == ("fast-car_1", ("FRONT_FACING_CAMERA",))


def test_folders_text_files_and_a_dot_before_names_are_no_matter(tmp_path):
    files = {"./model_metadata.json": b'{"action_space": [1]}', "ip/readme.txt": b"x"}
    path = archive(tmp_path / "m.tar.gz", files={**files, "model_metadata.json": None})

    assert check_file(path).sensors == ("observation",)


@pytest.mark.parametrize(
    "name",
    [
        "model.zip",
        "model.tar",
        "my model.tar.gz",
        "v1.2.tar.gz",
        ".tar.gz",
        "größe.tar.gz",
        "aws-golden-model-for-reinvent.tar.gz",
    ],
)
def test_a_name_that_the_car_would_change_is_refused(tmp_path, name):
    with pytest.raises(SettingsError, match="the car cannot use this file"):
        check_file(archive(tmp_path / name))


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        ({"agent/model.pb": None}, "no model file"),
        ({"model/model_1.pb": b"x"}, "2 model files"),
        ({"._model.pb": b"x"}, "2 model files"),
        ({"model/.coach_checkpoint": b"x"}, "takes model/.coach_checkpoint for model files"),
        ({"done": b"x"}, "files without an extension"),
        ({"a.p": b"x", "b.b": b"x"}, "takes a.p, b.b for"),
        ({"model_metadata.json": None}, "no model_metadata.json"),
        ({"model_metadata.json": None, "model/model_metadata.json": b"{}"}, "no model_metadata"),
        ({"model_metadata.json": b"[1]"}, "not a JSON object"),
        ({"model_metadata.json": b"{"}, "not a JSON object"),
        ({"model_metadata.json": b"[" * 100_000}, "not a JSON object"),
        ({"agent/model.pb": b""}, "is empty"),
        ({"../evil.txt": b"x"}, "outside of the model's folder"),
        ({"/etc/evil.txt": b"x"}, "outside of the model's folder"),
    ],
)
def test_content_that_the_car_refuses_is_named(tmp_path, files, sentence):
    with pytest.raises(SettingsError) as refusal:
        check_file(archive(tmp_path / "m.tar.gz", files=files))

    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("metadata", "sentence"),
    [
        ({"sensor": ["DISCRETIZED_SECTOR_LIDAR"]}, "does not know the sensor DISCRETIZED"),
        ({"sensor": "FRONT_FACING_CAMERA"}, "sensor in its model_metadata.json is not a list"),
        ({"training_algorithm": "dqn"}, "training_algorithm in its model_metadata.json is dqn"),
        ({"action_space_type": ["discrete"]}, "action_space_type"),
        ({"action_space": []}, "no action_space"),
    ],
)
def test_metadata_that_the_car_does_not_list_is_named(tmp_path, metadata, sentence):
    with pytest.raises(SettingsError) as refusal:
        check_file(archive(tmp_path / "m.tar.gz", metadata=metadata))

    assert sentence in str(refusal.value)


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE])
def test_links_and_devices_are_refused(tmp_path, kind):
    path = tmp_path / "m.tar.gz"
    with tarfile.open(path, "w:gz") as out:
        info = tarfile.TarInfo("link.txt")
        info.type, info.linkname = kind, "/etc/passwd"
        out.addfile(info)

    with pytest.raises(SettingsError, match="neither a file nor a folder"):
        check_file(path)


def test_a_file_that_is_no_archive_or_not_whole_is_refused(tmp_path):
    path = archive(tmp_path / "m.tar.gz", files={"agent/model.pb": os.urandom(100_000)})
    whole = path.read_bytes()
    damaged = [b"", b"text", gzip.compress(b"no tar"), whole[:50_000], whole[:20], whole[30:]]
    plain = io.BytesIO()
    tarfile.open(fileobj=plain, mode="w").close()

    for content in [*damaged, plain.getvalue()]:
        path.write_bytes(content)
        with pytest.raises(SettingsError, match="the car cannot use this file"):
            check_file(path)


def test_every_damaged_byte_of_the_head_is_a_sentence_or_no_matter(tmp_path):
    path = archive(tmp_path / "m.tar.gz")
    whole = path.read_bytes()

    refused = 0
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        try:
            check_file(path)
        except SettingsError:  # anything else fails the test
            refused += 1

    assert refused > len(whole) / 2


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "m.tar.gz"
    with gzip.open(path, "wb", 1) as out:
        info = tarfile.TarInfo("agent/model.pb")
        info.size = 2 << 30
        out.write(info.tobuf())

    with pytest.raises(SettingsError, match="more than 1 GiB"):
        check_file(path)


def test_a_file_that_is_not_there_or_a_folder_is_a_sentence(tmp_path):
    (tmp_path / "folder.tar.gz").mkdir()

    for name in ("none.tar.gz", "folder.tar.gz"):
        with pytest.raises(SettingsError, match="cannot be read"):
            check_file(tmp_path / name)
