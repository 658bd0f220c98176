"""Amazon, as moto plays it: in this process, or as one server for programs."""

from collections.abc import Iterator

import boto3
import pytest
from moto import mock_aws

from amazon_server import amazon_server
from drcli.bucket import endpoint
from drcli.outside.aws.aws_account import Account

REGION = "us-east-1"
UBUNTU = "ami-1e749f67"
"""An image that moto knows."""


@pytest.fixture(scope="module")
def keys() -> Iterator[None]:
    """Access keys, and no other settings of the AWS library."""
    endpoint.session_of.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        for name in ("AWS_PROFILE", "AWS_ENDPOINT_URL", "AWS_REGION", "AWS_SESSION_TOKEN"):
            patch.delenv(name, raising=False)
        patch.setenv("AWS_ACCESS_KEY_ID", "testing")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
        patch.setenv("AWS_CONFIG_FILE", "/nonexistent")
        patch.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nonexistent")
        yield
    endpoint.session_of.cache_clear()


@pytest.fixture(scope="module")
def shared_amazon(keys: None) -> Iterator[Account]:
    """An account at an Amazon in this process, with a bucket."""
    with mock_aws():
        boto3.client("s3", REGION).create_bucket(Bucket="models")
        yield Account(REGION, None)


@pytest.fixture
def amazon(shared_amazon: Account) -> Account:
    """The same account with an empty bucket; to make all of it again takes seconds."""
    bucket = shared_amazon.bucket("models")
    bucket.delete([info.key for info in bucket.list("")])
    return shared_amazon


@pytest.fixture(scope="module")
def moto_address() -> Iterator[str]:
    """Address of a server that plays Amazon."""
    with amazon_server() as address:
        yield address
