"""The racer's AWS account, with explained failures."""

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.bucket.endpoint import Endpoint, lend_to_refreshes, session_of
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.s3_errors import error_code, error_text
from drcli.config import secret_environment

with lazy_imports():
    from botocore import config as botocore_config
    from botocore import exceptions as boto
    from botocore import parsers as botocore_parsers

PROFILE_SETTING = "DR_LOCAL_S3_PROFILE"

_ACTION = re.compile(r"perform:? ([a-z0-9-]+:[A-Za-z*]+)")
_RESOURCE = re.compile(r"on resource: (\S+)")

DENIED = frozenset(
    {"AccessDenied", "AccessDeniedException", "UnauthorizedOperation", "AuthorizationError"}
)
_EXPIRED = frozenset({"ExpiredToken", "ExpiredTokenException", "RequestExpired"})
_WRONG_KEYS = frozenset(
    {
        "InvalidClientTokenId",
        "InvalidAccessKeyId",
        "UnrecognizedClientException",
        "SignatureDoesNotMatch",
        "AuthFailure",
        "InvalidSignatureException",
    }
)
_QUOTA = frozenset(
    {"VcpuLimitExceeded", "MaxSpotInstanceCountExceeded", "InstanceLimitExceeded", "LimitExceeded"}
)
_NO_CAPACITY = frozenset({"InsufficientInstanceCapacity", "UnfulfillableCapacity"})
_BUSY = frozenset({"Throttling", "ThrottlingException", "RequestLimitExceeded"})


class Account:
    """Clients of AWS services; without a profile, boto3 searches for keys.

    All functions of this package that ask Amazon raise StorageError when it fails.
    """

    def __init__(
        self, region: str, profile: str | None, *, attempts: int = 5, timeout_s: float = 60.0
    ) -> None:
        self.region = region
        self.profile = profile
        self._attempts, self._timeout_s = attempts, timeout_s
        self._clients: dict[tuple[str, str], Any] = {}

    def client(self, service: str, region: str = "") -> Any:
        """The client of a service.

        Raises:
            StorageError: The profile does not exist.
        """
        known = (service, region or self.region)
        if known not in self._clients:
            config = botocore_config.Config(
                retries={"total_max_attempts": self._attempts, "mode": "standard"},
                connect_timeout=10,
                read_timeout=self._timeout_s,
            )
            session: Any = session_of(self.profile, PROFILE_SETTING)
            with secret_environment.lent(), self.trying(f"use {service}"):
                self._clients[known] = session.client(service, region_name=known[1], config=config)
                lend_to_refreshes(session.get_credentials())
        return self._clients[known]

    def pages(self, service: str, operation: str, key: str, **asked: Any) -> list[Any]:
        """All entries of a listing in pages; raises errors of botocore."""
        pages = self.client(service).get_paginator(operation).paginate(**asked)
        return [entry for page in pages for entry in page.get(key, [])]

    def bucket(self, name: str) -> S3Bucket:
        endpoint = Endpoint(None, profile=self.profile, region=self.region)
        return S3Bucket(endpoint, name, patience_s=10.0)

    @contextmanager
    def trying(self, action: str, *, unless: Collection[str] = ()) -> Iterator[None]:
        """Explain failures of Amazon; the action is read after "Cannot".

        Error codes in `unless` only end the block.

        Raises:
            DrError: Amazon failed or refused.
        """
        try:
            yield
        except (
            boto.BotoCoreError,
            boto.ClientError,
            botocore_parsers.ResponseParserError,
        ) as error:
            if error_code(error) not in unless:
                raise explained(error, action, self.region) from error

    @cached_property
    def number(self) -> str:
        with self.trying("find out whose access keys these are"):
            return str(self.client("sts").get_caller_identity()["Account"])


def explained(error: Exception, action: str, region: str) -> DrError:
    code, said = error_code(error).removeprefix("Client."), error_text(error)
    start = f"Cannot {action}: "
    if isinstance(error, boto.NoCredentialsError | boto.PartialCredentialsError):
        return StorageError(
            f"{start}no access keys for Amazon were found on this machine.",
            remedy=f"Run `aws configure`, or name a profile with --profile or {PROFILE_SETTING}.",
        )
    by_sign_in = ("SSOTokenLoadError", "UnauthorizedSSOTokenError", "TokenRetrievalError")
    if code in _EXPIRED or type(error).__name__ in by_sign_in:
        return StorageError(
            f"{start}the temporary access keys have expired.",
            remedy="Sign in again, as with `aws sso login`, and repeat the command.",
        )
    if code in DENIED:
        return _denial(error, start, said)
    if code in _WRONG_KEYS:
        return StorageError(
            f"{start}Amazon does not know these access keys, or they belong to another account "
            f"({code}).",
            remedy=f"Correct the keys with `aws configure`, or choose other ones with "
            f"--profile or {PROFILE_SETTING}, and check the clock of this machine.",
        )
    if code in _QUOTA:
        return SettingsError(
            f"{start}a limit of your account is reached: {said} ({code}).",
            remedy="Ask for a higher quota in the console of Service Quotas, or stop other "
            "machines.",
        )
    if code in _NO_CAPACITY:
        return StorageError(
            f"{start}Amazon has no such machine free in {region} now ({code}).",
            remedy="Allow more types with --type or another region with --region; `dr-spot prices` "
            "shows them.",
        )
    if code in _BUSY:
        return StorageError(
            f"{start}Amazon refuses more requests for the moment ({code}).",
            remedy="Try again in a minute.",
        )
    if code == "OptInRequired":
        return StorageError(
            f"{start}your account may not use this service in {region} ({code}).",
            remedy="Enable it in the console of Amazon, or choose another region with --region.",
        )
    return _unanswered(error, start, region, code, said)


def _denial(error: Exception, start: str, said: str) -> StorageError:
    found, place = _ACTION.search(said), _RESOURCE.search(said)
    action = found[1] if found else f"for {getattr(error, 'operation_name', 'that')}"
    where = f" on {place[1]}" if place else ""
    return StorageError(
        f"{start}your access keys lack the permission {action}{where}.",
        remedy=f"Add {action} to the policy of these keys, or choose other keys with "
        f"--profile or {PROFILE_SETTING}.",
    )


def _unanswered(error: Exception, start: str, region: str, code: str, said: str) -> StorageError:
    if isinstance(error, boto.SSLError):
        return StorageError(
            f"{start}the certificate of Amazon in {region} is not valid.",
            remedy="Check the clock of this machine; behind a company's proxy, set AWS_CA_BUNDLE.",
        )
    if isinstance(error, boto.ConnectionError | boto.HTTPClientError):
        return StorageError(
            f"{start}Amazon in {region} cannot be reached.",
            remedy="Check the network connection, and the name of the region.",
        )
    if isinstance(error, botocore_parsers.ResponseParserError):
        return StorageError(
            f"{start}what answered for {region} is not Amazon.",
            remedy="Check the name of the region, and whether a proxy or the sign-in page of a "
            "network answers in Amazon's place.",
        )
    return StorageError(
        f"{start}{said}{f' ({code})' if code else ''}.",
        remedy="Correct what that sentence names, or try again later.",
    )
