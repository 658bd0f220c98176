"""Uploads to a bucket that refuses them: one sentence, and nothing there has changed."""

from collections.abc import Iterator
from typing import Any

import pytest

from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from refusing_s3 import Refusals, contents, refusing_server

OLD = {"team/model-1/model/9_Step-9.ckpt.index": b"old", "team/model-2/a": b"older"}


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[Endpoint, Refusals]]:
    with refusing_server() as both:
        yield both


@pytest.fixture
def refusals(server: tuple[Endpoint, Refusals]) -> Refusals:
    server[1].__init__()
    return server[1]


@pytest.fixture
def there(
    server: tuple[Endpoint, Refusals], refusals: Refusals, mover: Any, monkeypatch: Any
) -> Iterator[S3Bucket]:
    """A bucket for uploads with an old model, which the commands use."""
    bucket = S3Bucket(server[0], "uploads", patience_s=1)
    bucket.ensure_exists()
    # Servers of one process share their buckets, so another test may have left objects.
    bucket.delete([info.key for info in bucket.list("")])
    for key, data in OLD.items():
        bucket.put(key, data)
    mover.use(bucket)
    refusals.seen.clear()
    yield bucket
    refusals.actions = set()
    bucket.delete([info.key for info in bucket.list("")])
    bucket.close()


def after(bucket: S3Bucket, refusals: Refusals) -> dict[str, bytes]:
    refusals.actions = set()
    return contents(bucket)


def test_an_upload_is_refused_before_its_first_byte(dr, there, refusals, capsys):
    refusals.actions = {"s3:PutObject"}

    code = dr("upload-model", "-f", "-w")

    said = capsys.readouterr().err
    assert code == 4
    assert "cannot write to s3://uploads/team/model-1: the access keys of DR_UPLOAD_S3_PROF" in said
    assert "Add s3:PutObject on arn:aws:s3:::uploads/team/model-1/*" in said
    assert [line for line in refusals.seen if line.startswith("PUT")] == [
        "PUT /uploads/team/model-1/.drcli-write-test.txt"
    ]
    assert after(there, refusals) == OLD


def test_with_w_the_permission_to_delete_is_proved_first(dr, there, refusals, capsys):
    refusals.actions = {"s3:DeleteObject"}

    code = dr("upload-model", "-f", "-w")

    said = capsys.readouterr().err
    assert code == 4
    assert "s3:DeleteObject" in said
    left = after(there, refusals)
    assert left.pop("team/model-1/.drcli-write-test.txt")
    assert left == OLD


def test_without_w_an_upload_needs_no_permission_to_delete(dr, there, refusals, capsys):
    refusals.actions = {"s3:DeleteObject"}

    code = dr("upload-model", "-f")

    assert code == 0
    assert "s3:DeleteObject" in capsys.readouterr().err
    left = after(there, refusals)
    assert left["team/model-1/model/.coach_checkpoint"] == b"5_Step-500.ckpt"
    assert left.items() >= OLD.items()


def test_an_upload_leaves_no_test_object(dr, there, refusals):
    assert dr("upload-model", "-f") == 0

    assert not [key for key in after(there, refusals) if "test" in key or "probe" in key]


def test_a_dry_run_writes_nothing_and_says_what_it_cannot_tell(dr, there, refusals, capsys):
    refusals.actions = {"s3:PutObject"}

    code = dr("upload-model", "-d", "-w")

    assert code == 0
    assert "does not test the permission to write" in capsys.readouterr().err
    assert not [line for line in refusals.seen if line.startswith(("PUT", "POST"))]


def test_an_upload_under_the_next_name_that_is_refused_keeps_the_name(dr, mover, there, refusals):
    refusals.actions, refusals.below = {"s3:PutObject"}, "team/model-2"

    assert dr("upload-model", "-1", "-f") == 4
    assert mover.settings().upload_s3_prefix == "team/model-1"
    assert after(there, refusals) == OLD


def test_wiping_the_next_name_is_refused_before_the_question(dr, mover, there, refusals, capsys):
    refusals.actions = {"s3:DeleteObject"}

    code = dr("increment-upload-model", "-w")

    said = capsys.readouterr().err
    assert code == 4
    assert "cannot delete objects below s3://uploads/team/model-2" in said
    assert "Are you sure" not in said
    assert mover.settings().upload_s3_prefix == "team/model-1"
    assert after(there, refusals).items() >= OLD.items()


def test_custom_files_are_refused_before_the_first_one(dr, mover, there, refusals, capsys):
    mover.here.put, mover.here.get = there.put, there.get
    mover.here.delete, mover.here.list = there.delete, there.list
    files = mover.folder / "custom_files"
    files.mkdir(exist_ok=True)
    (files / "a.json").write_text("{}")
    refusals.actions = {"s3:PutObject"}

    code = dr("upload-custom-files")

    assert code == 4
    assert "cannot write to s3://bucket/custom_files" in capsys.readouterr().err
    assert after(there, refusals) == OLD
