"""Which server, region and keys a profile of the AWS files leads to."""

from pathlib import Path

import pytest

from drcli.base.errors import StorageError
from drcli.bucket import endpoint
from drcli.bucket.connect import open_upload_bucket
from drcli.bucket.endpoint import Profile, read_profile
from drcli.config.loading import load_settings

CONFIG = """
[default]
region = us-west-2
[profile minio]
region = eu-west-1
endpoint_url = http://127.0.0.1:9000
[profile service]
services = ours
[services ours]
s3 =
  endpoint_url = http://127.0.0.1:9001
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    """AWS files with some profiles, and nothing in the environment."""
    for name in ("AWS_PROFILE", "AWS_DEFAULT_PROFILE", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "credentials"))
    (tmp_path / "config").write_text(CONFIG)
    (tmp_path / "credentials").write_text(
        "[minio]\naws_access_key_id=AKmine\naws_secret_access_key=s\n"
    )
    endpoint.session_of.cache_clear()
    yield tmp_path
    endpoint.session_of.cache_clear()


@pytest.fixture
def opened(files):
    """Opens the bucket of uploads of some settings."""

    def run(*lines: str):
        folder = files / "racer"
        folder.mkdir()
        text = "\n".join(("DR_UPLOAD_S3_BUCKET=uploads", *lines))
        (folder / "system.env").write_text(text)
        (folder / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")
        return open_upload_bucket(load_settings(folder, environ={}).transfer.upload, patience_s=0)

    return run


@pytest.mark.parametrize(
    ("profile", "found"),
    [
        ("default", Profile(None, "us-west-2")),
        (None, Profile(None, "us-west-2")),
        ("minio", Profile("http://127.0.0.1:9000", "eu-west-1")),
        ("service", Profile("http://127.0.0.1:9001", None)),
    ],
)
def test_a_profile_names_server_and_region(files, profile, found):
    assert read_profile(profile, "DR_UPLOAD_S3_PROFILE") == found


def test_the_default_profile_need_not_exist(files):
    Path(files / "config").unlink()

    assert read_profile("default", "X") == Profile(None, None)
    assert endpoint.session_of("default", "X").profile_name == "default"


def test_another_profile_must_exist(files):
    with pytest.raises(
        StorageError, match=r"The profile 'nobody' does not exist in the AWS files \(DR_UPLOAD_S3_P"
    ):
        read_profile("nobody", "DR_UPLOAD_S3_PROFILE")


@pytest.mark.parametrize(
    "line", ["region = a b", "endpoint_url = nas:9000", "endpoint_url = http://[::1", "s3 = 5"]
)
def test_a_profile_that_the_aws_library_cannot_use_is_named(files, opened, line):
    (files / "config").write_text(f"[profile minio]\n{line}\n")

    with pytest.raises(StorageError, match=r"\(DR_UPLOAD_S3_PROFILE is 'minio'\)") as refusal:
        opened("DR_UPLOAD_S3_PROFILE=minio")

    assert "~/.aws/config" in refusal.value.remedy


def test_uploads_go_to_the_server_of_their_profile(opened):
    bucket = opened("DR_UPLOAD_S3_PROFILE=minio")

    assert (bucket.name, bucket.endpoint.url) == ("uploads", "http://127.0.0.1:9000")
    assert (bucket.endpoint.profile, bucket.endpoint.region) == ("minio", "eu-west-1")


def test_an_address_of_uploads_wins_over_that_of_the_profile(opened):
    bucket = opened("DR_UPLOAD_S3_PROFILE=minio", "DR_UPLOAD_S3_ENDPOINT_URL=http://127.0.0.1:9002")

    assert bucket.endpoint.url == "http://127.0.0.1:9002"


def test_without_either_uploads_go_to_amazon(opened):
    bucket = opened("DR_AWS_APP_REGION=us-east-1")

    assert (bucket.endpoint.url, bucket.endpoint.region) == (None, "us-west-2")


@pytest.mark.parametrize(
    ("lines", "setting"),
    [
        ([], "DR_UPLOAD_S3_PROFILE"),
        (["DR_UPLOAD_S3_ENDPOINT_URL=http://127.0.0.1:1"], "DR_UPLOAD_S3_ENDPOINT_URL"),
    ],
)
def test_a_silent_server_is_blamed_on_the_setting_that_chose_it(files, opened, lines, setting):
    (files / "config").write_text(CONFIG.replace("9000", "1"))
    bucket = opened("DR_UPLOAD_S3_PROFILE=minio", *lines)

    with pytest.raises(StorageError, match=rf"\({setting}\): no server answers there"):
        bucket.list("")
