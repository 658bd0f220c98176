"""Where a policy's file and its metadata are found, and what is refused."""

import io
import os
import tarfile

import pytest

from drcli.base.errors import ProblemsError, SettingsError
from drcli.convert.policy_file import metadata_path, read_policy_file
from small_policies import metadata_json


def pack(path, **members):
    with tarfile.open(path, "w:gz") as archive:
        for name, data in members.items():
            info = tarfile.TarInfo(name.replace("__", "/").replace("_pb", ".pb"))
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))


@pytest.mark.parametrize(
    ("name", "form"),
    [("a.pb", "pb"), ("A.ONNX", "onnx"), ("a.tflite", "tflite"), ("a.b.onnx", "onnx")],
)
def test_a_file_is_read_with_the_metadata_beside_it(tmp_path, name, form):
    path = tmp_path / name
    path.write_bytes(b"graph")
    (tmp_path / "model_metadata.json").write_bytes(metadata_json())

    found = read_policy_file(path)

    assert (found.form, found.data, found.weights) == (form, b"graph", b"")
    assert found.metadata_origin == str(tmp_path / "model_metadata.json")


def test_the_nearest_metadata_counts(tmp_path):
    path, named = tmp_path / "a.onnx", tmp_path / "other.json"
    path.write_bytes(b"graph")
    (tmp_path / "model_metadata.json").write_bytes(metadata_json(version="3"))
    metadata_path(path).write_bytes(metadata_json(version="4"))
    named.write_bytes(metadata_json(version="5"))

    assert read_policy_file(path).metadata.version == "4"
    assert read_policy_file(path, named).metadata.version == "5"


@pytest.mark.parametrize("name", ["a.xml", "a.bin"])
def test_both_files_of_openvino_are_read(tmp_path, name):
    (tmp_path / "a.xml").write_bytes(b"graph")
    (tmp_path / "a.bin").write_bytes(b"weights")
    metadata_path(tmp_path / "a.xml").write_bytes(metadata_json())

    found = read_policy_file(tmp_path / name)

    assert (found.form, found.data, found.weights) == ("openvino", b"graph", b"weights")
    (tmp_path / "a.bin").unlink()
    with pytest.raises(SettingsError, match=r"a\.bin cannot be read: No such file"):
        read_policy_file(tmp_path / "a.xml")


def test_an_archive_of_the_car_brings_its_metadata(tmp_path):
    path = tmp_path / "car.tar.gz"
    pack(path, agent__model_pb=b"graph", **{"model_metadata.json": metadata_json()})

    found = read_policy_file(path)

    assert (found.form, found.data) == ("pb", b"graph")
    assert found.origin == f"{path}: agent/model.pb"
    assert found.metadata_origin == f"{path}: model_metadata.json"


@pytest.mark.parametrize(
    ("members", "why"),
    [
        ({"readme": b"x"}, "instead of one frozen graph it has none"),
        ({"a_pb": b"x", "b_pb": b"x"}, r"it has 2 \(a\.pb, b\.pb\)"),
        ({"a_pb": b"x", "x__model_metadata.json": b"{", "y__model_metadata.json": b"{"}, "2 files"),
    ],
)
def test_an_archive_that_leaves_a_choice_is_refused(tmp_path, members, why):
    pack(tmp_path / "car.tar.gz", **members)

    with pytest.raises(SettingsError, match=why):
        read_policy_file(tmp_path / "car.tar.gz")


@pytest.mark.parametrize("name", ["ppo.zip", "policy.pth", "model.pkl"])
def test_a_pickle_is_refused_with_the_way_in(tmp_path, name):
    (tmp_path / name).write_bytes(b"\x80\x04.")

    with pytest.raises(SettingsError, match="is a Python pickle, as Stable-Baselines3") as caught:
        read_policy_file(tmp_path / name)

    assert "ONNX" in caught.value.remedy
    assert "`dr docs formats`" in caught.value.remedy


def test_what_is_no_readable_file_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "empty.pb").write_bytes(b"")
    (tmp_path / "folder.onnx").mkdir()
    os.mkfifo(tmp_path / "pipe.onnx")
    (tmp_path / "notes.txt").write_bytes(b"graph")

    for name, why in [
        ("empty.pb", "is empty"),
        ("folder.onnx", "cannot be read"),
        ("pipe.onnx", "cannot be read: It is not an ordinary file"),
        ("missing.onnx", "cannot be read: No such file"),
        ("missing.zip", "cannot be read: No such file"),
        ("notes.txt", "is not the file of a policy"),
    ]:
        with pytest.raises(SettingsError, match=why):
            read_policy_file(tmp_path / name)


def test_missing_or_wrong_metadata_is_named(tmp_path):
    path = tmp_path / "a.onnx"
    path.write_bytes(b"graph")

    with pytest.raises(SettingsError, match=r"a\.onnx has no model_metadata\.json") as caught:
        read_policy_file(path)
    assert "--metadata" in caught.value.remedy

    metadata_path(path).write_bytes(b'{"action_space": []}')
    with pytest.raises(ProblemsError, match=r"a\.model_metadata\.json"):
        read_policy_file(path)
