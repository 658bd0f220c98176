"""Failures of Amazon become one sentence, with what to do."""

import pytest
from botocore import exceptions as boto
from botocore import parsers

from drcli.base.errors import SettingsError, StorageError
from drcli.outside.aws.aws_account import Account, explained


def refused(code: str, message: str = "No.") -> boto.ClientError:
    return boto.ClientError({"Error": {"Code": code, "Message": message}}, "RunInstances")


@pytest.mark.parametrize(
    ("error", "kind", "sentence", "remedy"),
    [
        (boto.NoCredentialsError(), StorageError, "no access keys", "aws configure"),
        (refused("ExpiredToken"), StorageError, "have expired", "aws sso login"),
        (refused("Client.RequestExpired"), StorageError, "have expired", "aws sso login"),
        (
            refused("AccessDenied", "User: x is not authorized to perform: ec2:Run on resource: y"),
            StorageError,
            "lack the permission ec2:Run on y",
            "Add ec2:Run",
        ),
        (refused("UnauthorizedOperation"), StorageError, "for RunInstances", "policy"),
        (refused("InvalidClientTokenId"), StorageError, "does not know these", "clock"),
        (refused("VcpuLimitExceeded"), SettingsError, "a limit of your account", "quota"),
        (refused("InsufficientInstanceCapacity"), StorageError, "no such machine free", "--type"),
        (refused("Throttling"), StorageError, "refuses more requests", "minute"),
        (refused("OptInRequired"), StorageError, "may not use this service", "region"),
        (refused("Strange", "Odd thing."), StorageError, "Odd thing (Strange)", ""),
        (boto.EndpointConnectionError(endpoint_url="u"), StorageError, "cannot be reached", ""),
        (parsers.ResponseParserError("<!doctype html>"), StorageError, "is not Amazon", "proxy"),
        (boto.SSLError(endpoint_url="u", error="e"), StorageError, "certificate", "clock"),
    ],
)
def test_a_failure_is_one_sentence(error, kind, sentence, remedy):
    found = explained(error, "start a machine", "us-east-1")

    assert isinstance(found, kind)
    assert str(found).startswith("Cannot start a machine: ")
    assert sentence in str(found)
    assert str(found).endswith(".")
    assert remedy in found.remedy


def test_a_profile_that_does_not_exist_is_named(keys):
    with pytest.raises(StorageError, match="'nobody'"):
        Account("us-east-1", "nobody").client("ec2")


def test_an_answer_that_is_not_amazons_is_explained():
    with (
        pytest.raises(StorageError, match="is not Amazon"),
        Account("us-east-1", None).trying("list the types"),
    ):
        raise parsers.ResponseParserError("<!doctype html>")
