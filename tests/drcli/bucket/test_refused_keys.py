"""What a server that refuses the access keys is made to say, and what waits for keys to come."""

import json
from collections.abc import Callable, Iterator

import pytest

from drcli.base.errors import StorageError
from drcli.bucket import endpoint as profiles
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.s3_errors import AccessRefused
from drcli.checks.start_rules import probe
from drcli.model.model_store import ModelStore
from metadata_server import MetadataServer
from refusing_s3 import Refusals, refusing_server

ROLE = "/latest/meta-data/iam/security-credentials/"
KEYS = {
    "AccessKeyId": "AK",
    "SecretAccessKey": "secret",
    "Token": "token",
    "Code": "Success",
    "Expiration": "2099-01-01T00:00:00Z",
}


@pytest.fixture
def served() -> Iterator[tuple[S3Bucket, Refusals]]:
    with refusing_server() as (endpoint, refusals):
        bucket = S3Bucket(endpoint, "bucket", patience_s=0.2)
        bucket.ensure_exists()
        yield bucket, refusals
        bucket.close()


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Iterator[MetadataServer]:
    """A rented machine whose keys come from its metadata service alone, which is busy at first."""
    with MetadataServer() as service:
        service.refused = 503
        for name in ("AWS_ACCESS_KEY_ID", "AWS_EC2_METADATA_DISABLED", "AWS_PROFILE"):
            monkeypatch.delenv(name, raising=False)
        for name in ("AWS_CONFIG_FILE", "AWS_SHARED_CREDENTIALS_FILE"):
            monkeypatch.setenv(name, "/dev/null")
        monkeypatch.setenv("AWS_EC2_METADATA_SERVICE_ENDPOINT", service.address)
        profiles.session_of.cache_clear()
        yield service
        profiles.session_of.cache_clear()


CALLS: list[Callable[[S3Bucket], object]] = [
    lambda bucket: bucket.exists("model/key"),
    lambda bucket: bucket.get("model/key"),
    lambda bucket: bucket.put("model/key", b""),
    lambda bucket: bucket.list("model/"),
]


@pytest.mark.parametrize("call", CALLS)
def test_every_request_with_keys_that_have_expired_says_so(served, call):
    bucket, refusals = served
    refusals.everything, refusals.code, refusals.status = True, "ExpiredToken", 400

    with pytest.raises(StorageError, match="which have expired") as failure:
        call(bucket)

    assert "DR_UPLOAD_S3_PROFILE" in str(failure.value)
    assert "aws sso login" in failure.value.remedy


def test_a_look_up_that_is_denied_names_the_permission(served):
    bucket, refusals = served
    refusals.everything = True

    with pytest.raises(AccessRefused, match="lack the permission s3:GetObject") as failure:
        bucket.exists("model/ip/run.json")

    assert "Add s3:GetObject on arn:aws:s3:::bucket/model/ip/* to" in failure.value.remedy


def test_a_trial_that_is_denied_names_all_folders_of_the_model_and_none_of_its_own(served):
    bucket, refusals = served
    refusals.actions = {"s3:PutObject"}

    with pytest.raises(AccessRefused) as failure:
        probe(ModelStore(bucket, "team/model"))

    arn = "arn:aws:s3:::bucket/"
    folders = f"{arn}team/model/*, {arn}runs/team/model/*, {arn}rollouts/team/model/*"
    assert f"Add s3:PutObject on {folders} to the policy" in failure.value.remedy


@pytest.mark.parametrize("waits", [True, False])
def test_only_a_process_without_a_person_waits_for_keys_from_a_busy_service(served, machine, waits):
    pauses: list[float] = []

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) == 3:
            machine.refused = 0
            machine.answers |= {ROLE: "machine", f"{ROLE}machine": json.dumps(KEYS)}

    bucket = S3Bucket(Endpoint(served[0].endpoint.url), "bucket", unattended=waits, pause=pause)

    if not waits:
        with pytest.raises(StorageError, match="no access keys"):
            bucket.list("")
        return
    assert bucket.list("") == []
    assert len(pauses) == 3
