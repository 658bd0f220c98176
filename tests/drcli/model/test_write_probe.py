"""Proof that a bucket can be written, against a server that refuses as Amazon does."""

from collections.abc import Iterator

import pytest

from drcli.base import errors
from drcli.base.errors import StorageError
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.s3_errors import AccessRefused
from drcli.model.model_store import ModelStore
from drcli.model.write_probe import NAME, prove_writing
from refusing_s3 import Refusals, contents, refusing_server

KMS = (
    "User: arn:aws:iam::1:user/racer is not authorized to perform: kms:GenerateDataKey on "
    "resource: arn:aws:kms:eu-west-1:1:key/abc because no resource-based policy allows the "
    "kms:GenerateDataKey action"
)
DENY = (
    "User: arn:aws:iam::1:user/racer is not authorized to perform: s3:PutObject on resource: "
    '"arn:aws:s3:::uploads/team/x" with an explicit deny in a resource-based policy'
)


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[Endpoint, Refusals]]:
    with refusing_server() as both:
        yield both


@pytest.fixture
def refusals(server: tuple[Endpoint, Refusals]) -> Refusals:
    server[1].__init__()
    return server[1]


@pytest.fixture
def bucket(server: tuple[Endpoint, Refusals], refusals: Refusals) -> Iterator[S3Bucket]:
    bucket = S3Bucket(server[0], "uploads", patience_s=1)
    bucket.ensure_exists()
    # Servers of one process share their buckets, so another test may have left objects.
    bucket.delete([info.key for info in bucket.list("")])
    yield bucket
    refusals.actions = set()
    bucket.delete([info.key for info in bucket.list("")])
    bucket.close()


@pytest.fixture
def warnings(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    said: list[str] = []
    monkeypatch.setattr(errors, "warn", said.append)
    return said


def test_a_bucket_that_can_be_written_is_left_as_it_was(bucket, warnings):
    bucket.put("team/model-1/model/a", b"old")

    prove_writing(ModelStore(bucket, "team/model-1"), deletes=True)

    assert contents(bucket) == {"team/model-1/model/a": b"old"}
    assert warnings == []


@pytest.mark.parametrize(
    ("action", "sentence"),
    [
        ("s3:PutObject", "drcli cannot write to s3://uploads/team/model-1: the access keys of"),
        ("s3:GetObject", "drcli cannot read what it writes to s3://uploads/team/model-1: the"),
    ],
)
def test_a_missing_permission_is_named_with_bucket_prefix_and_what_to_add(
    bucket, refusals, action, sentence
):
    refusals.actions = {action}

    with pytest.raises(AccessRefused) as refusal:
        prove_writing(ModelStore(bucket, "team/model-1"), deletes=False)

    refusals.actions = set()
    assert contents(bucket) == {}
    assert str(refusal.value).startswith(sentence)
    assert f"DR_UPLOAD_S3_PROFILE lack the permission {action} (AccessDenied)" in str(refusal.value)
    assert refusal.value.remedy.startswith(
        f"Add {action} on arn:aws:s3:::uploads/team/model-1/* to the policy of these keys"
    )


def test_without_the_permission_to_delete_the_one_test_object_stays(bucket, refusals, warnings):
    refusals.actions = {"s3:DeleteObject"}

    prove_writing(ModelStore(bucket, "team/model-1"), deletes=False)
    prove_writing(ModelStore(bucket, "team/model-1"), deletes=False)

    assert list(contents(bucket)) == [f"team/model-1/{NAME}"]
    assert "lack the permission s3:DeleteObject" in warnings[0]
    assert f"{NAME} stays there" in warnings[0]


def test_a_caller_that_deletes_needs_that_permission(bucket, refusals, warnings):
    refusals.actions = {"s3:DeleteObject"}

    with pytest.raises(AccessRefused, match=r"cannot delete .* s3:DeleteObject") as refusal:
        prove_writing(ModelStore(bucket, "team/model-1"), deletes=True)

    assert "Add s3:DeleteObject on arn:aws:s3:::uploads/team/model-1/*" in refusal.value.remedy
    assert warnings == []


@pytest.mark.parametrize(
    ("status", "code", "message", "sentence", "remedy"),
    [
        (403, "InvalidAccessKeyId", "unknown", "server refuses the access keys", "Check the keys"),
        (403, "ExpiredToken", "late", "server refuses the access keys", "Check the keys"),
        (403, "RequestTimeTooSkewed", "late", "clocks of this machine", "Set the clock"),
        (404, "NoSuchBucket", "none", "bucket 'uploads' does not exist", "or create the bucket"),
        (403, "AccessDenied", KMS, "lack the permission kms:GenerateDataKey", "eu-west-1:1:key/a"),
        (400, "KMS.DisabledException", "off", "KMS key of the bucket cannot be used", "Enable"),
        (403, "AccessDenied", DENY, "the policy of the bucket denies s3:PutObject", "Ask the own"),
        (403, "AccessDenied", "Access Denied", "lack the permission s3:PutObject", "Add s3:PutO"),
        (405, "MethodNotAllowed", "no", "the server allows no changes", "read-only"),
        (301, "PermanentRedirect", "go", "the bucket is in another region", "DR_AWS_APP_REGION"),
        (
            400,
            "AuthorizationHeaderMalformed",
            "the region 'us-east-1' is wrong; expecting 'eu-west-1'",
            "the bucket is in another region, eu-west-1",
            "DR_AWS_APP_REGION",
        ),
    ],
)
def test_every_other_refusal_is_one_sentence_with_its_own_remedy(
    bucket, refusals, status, code, message, sentence, remedy
):
    refusals.actions = {"s3:PutObject"}
    refusals.status, refusals.code, refusals.message = status, code, message

    with pytest.raises(StorageError) as refusal:
        prove_writing(ModelStore(bucket, "team/model-1"), deletes=True)

    refusals.actions = set()
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert remedy in refusal.value.remedy
    assert contents(bucket) == {}


def test_a_server_that_alters_objects_is_refused(bucket, monkeypatch):
    monkeypatch.setattr(bucket, "get", lambda key: b"other")

    with pytest.raises(StorageError, match="other data than was written below s3://uploads/m"):
        prove_writing(ModelStore(bucket, "m"), deletes=True)

    assert [info.key for info in bucket.list("")] == []


def test_another_upload_that_has_just_deleted_the_test_object_is_no_matter(bucket, monkeypatch):
    written = bucket.put
    monkeypatch.setattr(bucket, "put", lambda key, data: (written(key, data), bucket.delete([key])))

    prove_writing(ModelStore(bucket, "m"), deletes=True)

    assert contents(bucket) == {}


def test_keys_for_one_prefix_are_enough(bucket, refusals):
    refusals.actions, refusals.below = {"s3:PutObject"}, "other"

    prove_writing(ModelStore(bucket, "team/model-1"), deletes=True)

    with pytest.raises(AccessRefused):
        prove_writing(ModelStore(bucket, "other/model-1"), deletes=True)
