"""Models that lie where MinIO kept them: they are found, and read or refused."""

import os
from dataclasses import replace

import pytest

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.transfer import minio_folder
from drcli.transfer.find_checkpoint import files_in_folder
from memory_bucket import MemoryBucket
from minio_files import BLOCK_BYTES, delete, put

from .conftest import put_model

LARGE = os.urandom(2 * BLOCK_BYTES + 5)
META = "xl.meta"


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "data" / "minio" / "bucket"


def read(folder, name):
    return files_in_folder(folder).read(name)


@pytest.mark.parametrize(
    ("parts", "inline"),
    [
        ([b"small"], True),
        ([b"small"], False),
        ([LARGE], False),
        ([LARGE[:BLOCK_BYTES]], False),
        ([LARGE, b"the rest"], False),
    ],
)
def test_an_object_is_read_bit_for_bit(folder, parts, inline):
    put(folder / "team/model/model/a.index", *parts, inline=inline)

    assert files_in_folder(folder).sizes == {"team/model/model/a.index": sum(map(len, parts))}
    assert read(folder, "team/model/model/a.index") == b"".join(parts)


def test_plain_files_of_an_older_minio_lie_beside_objects(folder):
    put(folder / "model/a", b"object", inline=True)
    put(folder / "model/.coach_checkpoint", b"a", inline=True)
    (folder / ".minio.sys").mkdir()
    (folder / "model" / "b").write_bytes(b"plain")

    assert files_in_folder(folder).sizes == {
        "model/a": 6,
        "model/b": 5,
        "model/.coach_checkpoint": 1,
    }
    assert read(folder, "model/b") == b"plain"


def test_what_was_deleted_is_not_there(folder):
    put(folder / "model/a", b"kept", inline=True)
    delete(folder / "model/b")

    assert list(files_in_folder(folder).sizes) == ["model/a"]


def test_an_object_alone_is_not_a_model(folder):
    put(folder / "model/a", b"x", inline=True)

    with pytest.raises(SettingsError, match="is one object of MinIO"):
        files_in_folder(folder / "model/a")


def cut(path):
    path.write_bytes(path.read_bytes()[:-3])


def flip(path):
    data = bytearray(path.read_bytes())
    data[-2] ^= 1
    path.write_bytes(bytes(data))


def part(folder):
    return next(folder.glob("a/*/part.1"))


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lambda f: cut(part(f)), "it has 97 bytes instead of 100"),
        (lambda f: part(f).write_bytes(b"x" * 32), "a block of it is cut off"),
        (lambda f: flip(part(f)), "its bytes do not fit its ETag"),
        (lambda f: part(f).unlink(), "part.1 cannot be read (No such file or directory)"),
        (lambda f: (f / "a" / META).write_bytes(b"XL2 "), "it does not begin with XL2"),
        (lambda f: cut(f / "a" / META), "is damaged: it is cut off"),
        (
            lambda f: (f / "a" / META).write_bytes((f / "a" / META).read_bytes()[:60]),
            "is damaged: it is cut off",
        ),
        (
            lambda f: (f / "a" / META).write_bytes(b"XL2 \x02\x00\x00\x00" + b"x" * 9),
            "has format 2.0 of a later MinIO",
        ),
        (lambda f: put(f / "a", b"x", EcM=2, EcN=2), "was spread over 4 drives by MinIO"),
        (
            lambda f: put(f / "a", b"x", MetaSys={"X-Minio-Internal-compression": b"s2"}),
            "was compressed by MinIO",
        ),
        (
            lambda f: put(
                f / "a", b"x", MetaSys={"X-Minio-Internal-Server-Side-Encryption-Iv": b"x"}
            ),
            "was encrypted by MinIO",
        ),
        (lambda f: put(f / "a", b"x", EcBSize=0), "a block of it is cut off"),
        (lambda f: put(f / "a", b"x", PartNums="one"), "Expected `array`, got `str`"),
        (lambda f: delete(f / "a"), "was deleted in MinIO"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(folder, harm, words):
    put(folder / "a", os.urandom(100))
    found = files_in_folder(folder)
    harm(folder)

    with pytest.raises(SettingsError) as caught:
        found.read("a")

    said = str(caught.value)
    assert words in said
    assert said.startswith(str(folder / "a"))
    assert "\n" not in said
    assert caught.value.remedy
    assert set(files_in_folder(folder).sizes) <= {"a"}  # others can be read all the same


def test_models_that_the_bucket_has_not_are_named(working_folder, monkeypatch):
    (working_folder / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")
    storage = load_settings(working_folder).storage
    bucket = MemoryBucket("bucket")
    put_model(bucket, "imported")
    for prefix in ("imported", "team/old", "zoo"):
        folder = working_folder / "data/minio/bucket" / prefix / "model"
        put(folder / "deepracer_checkpoints.json", b"{}", inline=True)

    models = minio_folder.unread_models(storage, working_folder, bucket)

    assert models == ["team/old", "zoo"]
    assert minio_folder.told_unread(models, bucket) == (
        "team/old and 1 more lie in data/minio/bucket, where MinIO kept them, not in the bucket.",
        "Run `dr-import data/minio/bucket/team/old -t team/old`.",
    )
    remote = replace(storage, cloud="remote")
    assert minio_folder.unread_models(remote, working_folder, bucket) == []
