"""Patience with servers in trouble, and the sentence once it ends."""

import io
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from pathlib import Path

import pytest
from botocore.exceptions import ClientError, EndpointConnectionError
from botocore.parsers import ResponseParserError
from botocore.response import StreamingBody

from drcli.base import errors
from drcli.base.errors import OwnershipLost, StorageError
from drcli.bucket import endpoint as profiles
from drcli.bucket import s3_bucket, s3_errors
from drcli.bucket.bucket import ObjectMissing
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.checks.start_rules import probe
from drcli.model.model_store import ModelStore
from refusing_s3 import refusing_server

LOCAL = Endpoint("http://127.0.0.1:1", "AKkey", "secret", engine="rclone")
REMOTE = Endpoint("http://127.0.0.1:1", "AKkey", "secret")


class Clock:
    """Time that passes only while somebody waits."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.pauses_s: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def pause(self, seconds: float) -> None:
        self.now_s += seconds
        self.pauses_s.append(seconds)


def answer(code: str, status: int) -> ClientError:
    return ClientError(
        {"Error": {"Code": code}, "ResponseMetadata": {"HTTPStatusCode": status}}, "GetObject"
    )


SILENT = EndpointConnectionError(endpoint_url="http://127.0.0.1:1")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def scripted(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Callable[..., S3Bucket]:
    """A bucket whose server answers a read with these failures, one after the other."""

    def make(*answers: Exception, endpoint: Endpoint = LOCAL, repeat: bool = False) -> S3Bucket:
        bucket = S3Bucket(endpoint, "bucket", patience_s=60, clock=clock, pause=clock.pause)
        script = list(answers)

        def get_object(**_: str) -> dict[str, StreamingBody]:
            if script:
                raise script[0] if repeat else script.pop(0)
            return {"Body": StreamingBody(io.BytesIO(b"data"), 4)}

        monkeypatch.setattr(bucket._client, "get_object", get_object)
        return bucket

    return make


def test_a_server_that_comes_back_within_the_patience_is_no_failure(scripted, clock):
    bucket = scripted(SILENT, SILENT, SILENT)

    assert bucket.get("k") == b"data"
    assert clock.pauses_s == [0.05, 0.1, 0.2]


def test_a_read_during_an_overwrite_is_repeated(scripted):
    bucket = scripted(answer("InternalError", 500))

    assert bucket.get("k") == b"data"


def test_a_silent_server_is_given_up_after_the_patience(scripted, clock, monkeypatch):
    said = []
    monkeypatch.setattr(errors, "show", said.append)
    bucket = scripted(SILENT, endpoint=REMOTE, repeat=True)

    with pytest.raises(StorageError, match=r"no server answers") as failure:
        bucket.get("m/k")

    assert clock.now_s == pytest.approx(60)
    assert said == ["Waiting for an answer from http://127.0.0.1:1 ..."]
    assert max(clock.pauses_s) == 1.0
    assert "bucket/m/k at http://127.0.0.1:1 (DR_REMOTE_MINIO_URL)" in str(failure.value)
    assert "DR_REMOTE_MINIO_URL" in failure.value.remedy


@pytest.mark.parametrize(
    ("headers", "age_s"),
    [
        ({"date": "Sun, 22 Nov 2026 09:01:10 GMT"}, 70.0),
        ({"date": "Sun, 22 Nov 2026 08:59:59 GMT"}, 0.0),
        ({}, None),
    ],
)
def test_how_old_an_object_is_says_the_clock_of_the_server_alone(monkeypatch, headers, age_s):
    bucket = S3Bucket(REMOTE, "bucket")
    found = {
        "Body": io.BytesIO(b"data"),
        "LastModified": datetime(2026, 11, 22, 9, tzinfo=UTC),
        "ResponseMetadata": {"HTTPHeaders": headers},
    }
    monkeypatch.setattr(bucket._client, "get_object", lambda **_: found)

    assert bucket.get_with_age("k") == (b"data", age_s)


def test_whoever_was_asked_to_leave_has_little_patience(scripted, clock):
    bucket = scripted(SILENT, repeat=True)
    bucket._hurried = lambda: clock.now_s > 20.0

    with pytest.raises(StorageError, match="no server answers"):
        bucket.get("k")

    assert 20.0 < clock.now_s < 22.0


def test_a_short_failure_is_overcome_by_one_that_was_asked_to_leave(scripted):
    bucket = scripted(SILENT, SILENT)
    bucket._hurried = lambda: True

    assert bucket.get("k") == b"data"


def test_a_write_that_is_tried_again_asks_its_fence_again(clock, monkeypatch):
    bucket = S3Bucket(LOCAL, "bucket", clock=clock, pause=clock.pause)

    def put_object(**_: object) -> None:
        raise SILENT

    def check(key: str) -> None:
        if clock.now_s > 5.0:
            raise OwnershipLost("Theirs.", remedy="Leave it.")

    monkeypatch.setattr(bucket._client, "put_object", put_object)

    with pytest.raises(OwnershipLost):
        bucket.fenced(check).put("k", b"data")


def test_a_server_with_an_inner_failure_gets_a_tenth_of_the_patience(scripted, clock):
    bucket = scripted(answer("InternalError", 500), repeat=True)

    with pytest.raises(StorageError, match="500 InternalError"):
        bucket.get("k")

    assert clock.now_s == pytest.approx(6)


@pytest.mark.parametrize(
    ("code", "status"),
    [("InternalError", 500), ("SlowDown", 503), ("500", 500)],
)
def test_a_server_elsewhere_gets_all_the_patience_for_what_passes(scripted, clock, code, status):
    bucket = scripted(answer(code, status), endpoint=REMOTE, repeat=True)

    with pytest.raises(StorageError):
        bucket.get("k")

    assert clock.now_s == pytest.approx(60)


def test_an_answer_that_is_no_xml_is_asked_for_again(scripted):
    bucket = scripted(ResponseParserError("no element found"), endpoint=REMOTE)

    assert bucket.get("k") == b"data"


def test_an_outage_is_said_once_however_many_calls_it_meets(scripted, clock, monkeypatch):
    said = []
    monkeypatch.setattr(errors, "show", said.append)
    bucket = scripted(*[SILENT] * 40, endpoint=REMOTE)
    bucket._patience_s = 15

    for _ in range(2):
        with pytest.raises(StorageError):
            bucket.fenced(lambda key: None).get("k")
    assert bucket.get("k") == b"data"

    assert said[0] == "Waiting for an answer from http://127.0.0.1:1 ..."
    assert said[1:] == [f"http://127.0.0.1:1 answers again, after {clock.now_s:.0f} s."]


def test_short_failures_are_not_said_again_and_again(scripted, clock, monkeypatch):
    said = []
    monkeypatch.setattr(errors, "show", said.append)
    for _ in range(5):  # several buckets of one process, each with its own client
        bucket = scripted(*[SILENT] * 6)
        for _ in range(3):
            assert bucket.get("k") == b"data"

    assert said == ["Waiting for an answer from http://127.0.0.1:1 ..."]


def test_an_object_that_could_not_be_deleted_just_then_is_deleted_again(clock, monkeypatch):
    bucket = S3Bucket(REMOTE, "bucket", clock=clock, pause=clock.pause)
    failure = {"Key": "b", "Code": "SlowDown", "Message": "Please reduce your request rate."}
    metadata = {"HTTPStatusCode": 200}
    answers = [{"Errors": [failure], "ResponseMetadata": metadata}, {"Errors": []}]
    asked = []

    def delete_objects(Bucket: str, Delete: dict) -> dict:  # noqa: N803  names of boto3
        asked.append([item["Key"] for item in Delete["Objects"]])
        return answers.pop(0)

    monkeypatch.setattr(bucket._client, "delete_objects", delete_objects)

    bucket.delete(["a", "b"])

    assert asked == [["a", "b"], ["a", "b"]]


@pytest.mark.parametrize("code", ["SignatureDoesNotMatch", "InvalidAccessKeyId"])
def test_refused_keys_are_no_matter_of_patience(scripted, clock, code):
    bucket = scripted(answer(code, 403), endpoint=REMOTE, repeat=True)

    with pytest.raises(StorageError, match=r"refuses the access keys of DR_LOCAL_S3_PROFILE"):
        bucket.get("k")

    assert clock.pauses_s == []


@pytest.mark.parametrize(("unattended", "waited_s"), [(False, 0.0), (True, 60.0)])
def test_only_a_process_without_a_person_waits_for_the_clock_to_be_set(
    scripted, clock, unattended, waited_s
):
    bucket = scripted(answer("RequestTimeTooSkewed", 403), endpoint=REMOTE, repeat=True)
    bucket._unattended = unattended

    with pytest.raises(StorageError, match="the clocks of this machine and of the server differ"):
        bucket.get("k")

    assert clock.now_s == pytest.approx(waited_s)


@pytest.mark.parametrize(
    ("minutes", "said"),
    [(-20, "the clocks of this machine"), (20, "the clocks of this machine"), (10, "lack the")],
)
@pytest.mark.parametrize("status", [400, 403])
def test_a_refusal_by_a_server_with_another_time_is_one_because_of_the_clock(
    scripted, minutes, said, status
):
    refusal = answer("AccessDenied", status)
    date = format_datetime(datetime.now(UTC) + timedelta(minutes=minutes), usegmt=True)
    refusal.response["ResponseMetadata"]["HTTPHeaders"] = {"date": date}
    bucket = scripted(refusal, endpoint=REMOTE, repeat=True)

    with pytest.raises(StorageError, match=said):
        bucket.get("k")


def test_a_process_that_waits_for_the_clock_to_be_set_says_so(scripted, monkeypatch):
    said: list[str] = []
    monkeypatch.setattr(errors, "show", said.append)
    bucket = scripted(answer("RequestTimeTooSkewed", 403), endpoint=REMOTE, repeat=True)
    bucket._unattended = True

    with pytest.raises(StorageError):
        bucket.get("k")

    assert len(said) == 1
    assert "until the clock of this machine is set" in said[0]
    assert "timedatectl" in said[0]


def test_a_missing_permission_is_named_at_once(scripted, clock):
    bucket = scripted(answer("AccessDenied", 403), endpoint=REMOTE, repeat=True)

    with pytest.raises(StorageError, match=r"keys of DR_LOCAL_S3_PROFILE lack .* s3:GetObject"):
        bucket.get("k")

    assert clock.pauses_s == []


def test_a_missing_bucket_names_the_variable(scripted):
    bucket = scripted(answer("NoSuchBucket", 404), repeat=True)

    with pytest.raises(
        StorageError, match=r"bucket 'bucket' does not exist.*DR_LOCAL_S3_BUCKET"
    ) as failure:
        bucket.get("k")

    assert not isinstance(failure.value, ObjectMissing)


def test_a_name_that_the_server_takes_for_no_bucket_names_the_variable(scripted):
    bucket = scripted(answer("InvalidBucketName", 400))

    with pytest.raises(StorageError, match=r"accept 'bucket' .*\(DR_LOCAL_S3_BUCKET\)") as refusal:
        bucket.get("k")

    assert "Set DR_LOCAL_S3_BUCKET to" in refusal.value.remedy
    assert "log" not in refusal.value.remedy


def test_a_full_server_is_said_to_be_full_at_once(scripted, clock):
    bucket = scripted(answer("XMinioStorageFull", 507), repeat=True)

    with pytest.raises(StorageError, match="disk is full") as failure:
        bucket.get("k")

    assert clock.pauses_s == []
    assert "Make room" in failure.value.remedy


def test_a_failed_write_on_a_full_local_disk_says_so(tmp_path: Path, monkeypatch):
    endpoint = Endpoint("http://127.0.0.1:1", "AKkey", "secret", engine="rclone", data_dir=tmp_path)
    attempt = s3_errors.Attempt("write", endpoint, "bucket", "m/k", size_bytes=10**18)

    found = s3_errors.explain(answer("InternalError", 500), attempt)

    assert str(found) == (
        f"Cannot write bucket/m/k at http://127.0.0.1:1: the disk under {tmp_path} is full."
    )


def test_a_profile_that_does_not_exist_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "none"))
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))

    with pytest.raises(
        StorageError, match=r"The profile 'minio' does not exist.*DR_LOCAL_S3_PROFILE"
    ):
        S3Bucket(Endpoint("http://127.0.0.1:1", profile="minio"), "bucket")


def test_missing_keys_name_the_profile_setting(monkeypatch, tmp_path):
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "none"))
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_PROFILE", "AWS_DEFAULT_PROFILE"):
        monkeypatch.delenv(name, raising=False)
    profiles.session_of.cache_clear()

    with pytest.raises(StorageError, match="no access keys"):
        S3Bucket(Endpoint("http://127.0.0.1:1"), "bucket", patience_s=0).get("k")

    profiles.session_of.cache_clear()


def test_secret_keys_are_not_printed():
    assert "secret" not in repr(LOCAL)


def test_a_listing_of_several_pages_is_complete_and_sorted(wire, monkeypatch):
    monkeypatch.setattr(s3_bucket, "_PAGE_KEYS", 2)
    for name in "edcba":
        wire.put(f"m/{name}", b"")

    assert [info.key for info in wire.list("m/")] == ["m/a", "m/b", "m/c", "m/d", "m/e"]


def test_more_keys_than_one_request_takes_are_all_deleted(wire, monkeypatch):
    monkeypatch.setattr(s3_bucket, "_PAGE_KEYS", 2)
    for name in "abcde":
        wire.put(f"m/{name}", b"")

    wire.delete(f"m/{name}" for name in "abcde")

    assert wire.list("m/") == []


def test_a_large_object_travels_in_parts_and_arrives_whole(wire, monkeypatch):
    monkeypatch.setattr(s3_bucket, "MULTIPART_FROM_BYTES", 6 << 20)
    monkeypatch.setattr(s3_bucket, "PART_BYTES", 5 << 20)
    data = bytes(range(256)) * (12 << 12)

    wire.put("m/large", data)

    assert wire.get("m/large") == data
    assert wire.list("m/")[0].etag.endswith("-3")  # S3 counts the parts there


def test_a_probe_of_a_missing_bucket_names_it(moto_endpoint):
    bucket = S3Bucket(moto_endpoint, "another", patience_s=0)

    with pytest.raises(StorageError, match="bucket 'another' does not exist"):
        probe(ModelStore(bucket, "model"))


def test_a_write_during_an_outage_takes_no_longer_because_the_server_may_need_a_folder(
    clock, monkeypatch
):
    bucket = S3Bucket(REMOTE, "bucket", patience_s=60, clock=clock, pause=clock.pause)

    def busy(**_: object) -> None:
        raise answer("ServiceUnavailable", 503)

    for call in ("put_object", "head_object", "get_object"):
        monkeypatch.setattr(bucket._client, call, busy)

    with pytest.raises(StorageError, match="503"):
        bucket.put("team/model/checkpoint", b"")

    assert clock.now_s == pytest.approx(60)


@pytest.mark.parametrize(
    ("code", "status"),
    [("XMinioParentIsObject", 400), ("ExistingObjectIsFile", 409), ("ObjectParentIsFile", 409)],
)
def test_an_object_where_another_server_needs_a_folder_is_named(code, status):
    with refusing_server() as (endpoint, refusals):
        bucket = S3Bucket(endpoint, "blocked", patience_s=0)
        bucket.ensure_exists()
        bucket.put("races", b"")
        refusals.actions, refusals.below = {"s3:PutObject"}, "races/"
        refusals.code, refusals.status = code, status

        with pytest.raises(StorageError, match=r"object blocked/races \(0 bytes\)") as blocked:
            bucket.put("races/1/race.json", b"{}")

    assert f"`aws --endpoint-url {endpoint.url} s3 rm s3://blocked/races`" in blocked.value.remedy
    bucket.close()
