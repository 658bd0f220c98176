"""The embedded server's bucket as plain files."""

import os
import time

import pytest

from drcli.bucket.bucket import ObjectMissing
from drcli.bucket.connect import FolderBucket


@pytest.fixture
def bucket(tmp_path):
    folder = tmp_path / "bucket"
    for key, text in {"m/model/1.ckpt": "one", "m/a.json": "{}", "m-1/a.json": "other"}.items():
        (folder / key).parent.mkdir(parents=True, exist_ok=True)
        (folder / key).write_text(text)
    (folder / "m" / ".rclone_temp_put_1").write_text("half")
    (folder / "m" / "model_$folder$").write_text("")
    (folder / ".keep").write_text("")
    return FolderBucket(folder)


def test_objects_are_read_as_the_server_gives_them_out(bucket):
    watched = []

    assert bucket.get("m/model/1.ckpt", watch=watched.append) == b"one"
    assert watched == [3]
    os.utime(bucket._folder / "m/model/1.ckpt", (0, time.time() - 100.0))
    assert bucket.get_with_age("m/model/1.ckpt") == (b"one", pytest.approx(100.0, abs=5.0))
    assert bucket.name == "bucket"


@pytest.mark.parametrize("key", ["m/b.json", "m/model", "m/a.json/x", "x/y"])
def test_what_is_no_object_is_missing(bucket, key):
    assert not bucket.exists(key)
    with pytest.raises(ObjectMissing, match=f"object bucket/{key} does not exist"):
        bucket.get(key)


def test_a_listing_is_of_one_folder_sorted_without_placeholders_and_what_is_half_written(bucket):
    found = bucket.list("m/")

    sizes = {info.key: info.size_bytes for info in found}
    assert list(sizes.items()) == [("m/a.json", 2), ("m/model/1.ckpt", 3)]
    assert next(info.key for info in bucket.list("")) == "m-1/a.json"
    assert bucket.list("nothing/") == []


def test_nothing_is_written_beside_the_server(bucket):
    with pytest.raises(TypeError, match="read-only"):
        bucket.put("m/new", b"")
    with pytest.raises(TypeError, match="read-only"):
        bucket.delete(["m/a.json"])
