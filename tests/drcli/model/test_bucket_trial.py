"""What a trial finds out about a bucket, and that it leaves the bucket as it was."""

import time

import pytest

from drcli.base.errors import StorageError
from drcli.bucket.s3_bucket import S3Bucket
from drcli.checks.doctor.bucket_health import try_bucket
from drcli.model.model_prefix import is_used
from drcli.model.model_store import ModelStore
from refusing_s3 import contents, refusing_server

FOLDERS = ["model/", "runs/model/", "rollouts/model/"]


@pytest.fixture(scope="module")
def server():
    with refusing_server() as served:
        yield served


@pytest.fixture
def bucket(server):
    endpoint, refusals = server
    bucket = S3Bucket(endpoint, "bucket", patience_s=0.2, read_timeout_s=2)
    bucket.ensure_exists()
    yield bucket
    refusals.actions, refusals.below, refusals.code = set(), "", "AccessDenied"
    bucket.delete([info.key for info in bucket.list("")])
    bucket.close()


@pytest.fixture
def refusals(server, bucket):
    return server[1]


def test_a_bucket_that_works_is_measured_and_left_as_it_was(bucket):
    bucket.put("model/a", b"1")

    trial = try_bucket(bucket, FOLDERS, seconds=5)

    assert (trial.worked, trial.refused, trial.wrong, trial.left) == (FOLDERS, [], "", [])
    assert trial.round_trip_ms > 0
    assert trial.write_mb_s > 0
    assert trial.read_mb_s > 0
    assert abs(trial.clock_ahead_s) < 5
    assert contents(bucket) == {"model/a": b"1"}


@pytest.mark.parametrize(
    ("permission", "actions"),
    [
        ("s3:PutObject", {"write"}),
        ("s3:GetObject", {"read"}),
        ("s3:DeleteObject", {"delete"}),
        ("s3:ListBucket", {"list"}),
    ],
)
def test_a_missing_permission_is_found_in_every_folder_and_named(
    bucket, refusals, permission, actions
):
    refusals.actions = {permission}

    trial = try_bucket(bucket, FOLDERS, seconds=5)

    assert actions <= {each.action for each in trial.refused}
    assert {each.folder for each in trial.refused if each.action in actions} == set(FOLDERS)
    assert all(permission in each.remedy for each in trial.refused)
    assert trial.worked == []


def test_keys_for_one_folder_work_there_alone(bucket, refusals):
    refusals.actions, refusals.below = {"s3:PutObject"}, "rollouts/"

    trial = try_bucket(bucket, FOLDERS, seconds=5)

    assert trial.worked == FOLDERS[:2]
    assert [(each.folder, each.action) for each in trial.refused] == [("rollouts/model/", "write")]


def test_where_nothing_can_be_deleted_one_object_stays_and_is_no_model(bucket, refusals):
    refusals.actions = {"s3:DeleteObject"}

    first = try_bucket(bucket, FOLDERS, seconds=5)
    second = try_bucket(bucket, FOLDERS, seconds=5)

    assert first.left == second.left == sorted(contents(bucket), key=first.left.index)
    assert len(first.left) == len(FOLDERS)
    assert not is_used(ModelStore(bucket, "model"))


def test_a_server_that_overwrites_late_is_found(bucket, monkeypatch):
    put = bucket.put
    kept = set()

    def put_once(key, data):
        if key not in kept:
            put(key, data)
        kept.add(key)

    monkeypatch.setattr(bucket, "put", put_once)

    assert "does not return" in try_bucket(bucket, FOLDERS, seconds=5).wrong


def test_a_server_that_does_not_know_the_keys_is_an_error_and_not_a_list_of_refusals(
    bucket, refusals
):
    refusals.actions = {"s3:PutObject"}
    refusals.code = "InvalidAccessKeyId"

    with pytest.raises(StorageError, match="refuses the access keys"):
        try_bucket(bucket, FOLDERS, seconds=5)


def test_a_missing_bucket_is_an_error(server):
    with pytest.raises(StorageError, match="does not exist"):
        try_bucket(S3Bucket(server[0], "another", patience_s=0), FOLDERS, seconds=5)


def test_without_time_nothing_is_begun_and_that_is_said(bucket):
    began_s = time.monotonic()

    trial = try_bucket(bucket, FOLDERS, seconds=0)

    assert trial.late
    assert trial.worked == []
    assert contents(bucket) == {}
    assert time.monotonic() - began_s < 2
