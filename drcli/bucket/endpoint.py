"""The address of an S3 server, with keys and their settings."""

import os
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.base.errors import StorageError
from drcli.base.installation import lazy_imports
from drcli.config import secret_environment
from drcli.config.run_config import Engine

if TYPE_CHECKING:
    from boto3.session import Session
    from botocore.loaders import Loader
    from botocore.session import Session as CoreSession

with lazy_imports():
    from boto3 import session as boto3_session
    from botocore import configprovider
    from botocore import exceptions as boto
    from botocore import loaders as botocore_loaders
    from botocore import session as core


@dataclass(frozen=True)
class SettingNames:
    bucket: str = "DR_LOCAL_S3_BUCKET"
    prefix: str = "DR_LOCAL_S3_MODEL_PREFIX"
    profile: str = "DR_LOCAL_S3_PROFILE"
    address: str = "DR_REMOTE_MINIO_URL"
    amazon: str = "DR_CLOUD=aws"


UPLOADS = SettingNames(
    bucket="DR_UPLOAD_S3_BUCKET",
    prefix="DR_UPLOAD_S3_PREFIX",
    profile="DR_UPLOAD_S3_PROFILE",
    address="DR_UPLOAD_S3_ENDPOINT_URL",
    amazon="DR_UPLOAD_S3_PROFILE",
)


@dataclass(frozen=True)
class Endpoint:
    """The address of an S3 server, and its keys.

    Args:
        url: None for Amazon's.
        access_key: None if boto3 finds the keys.
        secret_key: Never printed.
        profile: In the AWS files.
        region: To sign for.
        engine: Of a local server, as the next two.
        pid: If known.
        data_dir: Its folder.
        names: Of the settings.
    """

    url: str | None
    access_key: str | None = None
    secret_key: str | None = field(default=None, repr=False)
    profile: str | None = None
    region: str = "us-east-1"
    engine: Engine | None = None
    pid: int | None = None
    data_dir: Path | None = None
    names: SettingNames = SettingNames()

    @property
    def setting(self) -> str:
        if self.engine is not None:
            return "DR_CLOUD=local"
        return self.names.amazon if self.url is None else self.names.address

    @property
    def place(self) -> str:
        """For a sentence, without a password."""
        if self.url is None:
            return f"Amazon S3 ({self.region})"
        scheme, colon, rest = self.url.partition("://")
        return scheme + colon + rest.rpartition("@")[2]


# Profiles in the AWS files: keys, server and region.


DEFAULT = "default"
"""Need not exist: AWS then looks elsewhere, as for a role."""


@dataclass(frozen=True)
class Profile:
    endpoint_url: str | None
    region: str | None


@cache
def session_of(profile: str | None, setting: str) -> "Session":
    """The boto3 session of a profile, reused as the description of S3 is slow to load.

    Raises:
        StorageError: There is no such profile, or the files cannot be read.
    """
    session: Session = boto3_session.Session(botocore_session=_profile_session(profile, setting))
    return session


def get_ready() -> None:
    """Load the AWS library and its description of S3; looks for no keys, and sends no request."""
    session = core.Session()
    for files in ("config_file", "credentials_file"):
        session.set_config_variable(files, os.devnull)
    session.register_component("data_loader", _loader(None))
    session.create_client(
        "s3",
        "us-east-1",
        endpoint_url="http://localhost",
        aws_access_key_id="none",
        aws_secret_access_key="none",
    )


@cache
def _loader(path: str | None) -> "Loader":
    """Reads the description of S3, once for all sessions."""
    return botocore_loaders.create_loader(path)


_used: list[object] = []


def keys_in_use() -> set[str]:
    found: set[str] = set()
    for credentials in _used:
        names = ("_access_key", "_secret_key", "_token", "access_key", "secret_key", "token")
        values = vars(credentials)
        found |= {value for name in names if isinstance(value := values.get(name), str)}
    return found


def lend_to_refreshes(credentials: object) -> None:
    """Put withheld secrets into the environment whenever boto3 renews keys.

    It then needs a container's token, or runs a program. Fixed keys never renew.
    """
    if credentials is not None:
        _used.append(credentials)
    fetch = getattr(credentials, "_refresh_using", None)
    if fetch is None:
        return

    def refresh() -> object:
        with secret_environment.lent():
            return fetch()

    # botocore has only this private name; if it is missing, nothing is done.
    credentials._refresh_using = refresh  # type: ignore[attr-defined]


def read_profile(profile: str | None, setting: str) -> Profile:
    """From environment and AWS files.

    Raises:
        StorageError: There is no such profile, or the files cannot be read.
    """
    files = _profile_session(profile, setting)
    scoped = files.get_scoped_config()
    provider = configprovider.ConfiguredEndpointProvider(
        full_config=files.full_config, scoped_config=scoped, client_name="s3"
    )
    return Profile(provider.provide(), scoped.get("region"))


def _profile_session(profile: str | None, setting: str) -> "CoreSession":
    session: CoreSession = core.Session(profile=profile)
    try:
        session.get_scoped_config()
    except boto.ProfileNotFound as e:
        if profile == DEFAULT:
            return _profile_session(None, setting)
        raise _no_profile(profile, setting) from e
    except boto.BotoCoreError as e:
        raise StorageError(
            f"The AWS files cannot be used ({setting} is '{profile or ''}'): {e}.",
            remedy="Correct ~/.aws/config and ~/.aws/credentials.",
        ) from e
    session.register_component("data_loader", _loader(session.get_config_variable("data_path")))
    return session


def _no_profile(profile: str | None, setting: str) -> StorageError:
    if profile is None:
        return StorageError(
            "The profile named in AWS_PROFILE does not exist in the AWS files.",
            remedy=f"Correct AWS_PROFILE, or set {setting}.",
        )
    return StorageError(
        f"The profile '{profile}' does not exist in the AWS files ({setting}).",
        remedy=f"Create it with `aws configure --profile {profile}`, or set {setting} to "
        "another one.",
    )
