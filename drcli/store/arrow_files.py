"""The bucket as an Apache Arrow file system, for Ray Tune."""

from typing import Any

from drcli.config import secret_environment
from drcli.config.bucket_config import StorageConfig
from drcli.store.profiles import DEFAULT, session_of
from drcli.store.server import server


def arrow_files(storage: StorageConfig) -> Any:
    """The file system; paths begin with the bucket's name.

    Other machines get keys from the environment or a profile; without these, Arrow finds their own,
    as those of a role.

    Raises:
        StorageError: The server does not answer, or the profile does not exist.
    """
    from pyarrow.fs import S3FileSystem

    endpoint = server.ensure_running(storage)
    options: dict[str, Any] = {"region": endpoint.region}
    if endpoint.url is not None:
        scheme, _, place = endpoint.url.partition("://")
        options |= {"scheme": scheme, "endpoint_override": place}
    known = secret_environment.all_secrets()
    access, secret = endpoint.access_key, endpoint.secret_key
    token = None
    if access is None and "AWS_SECRET_ACCESS_KEY" in known:
        access = known.get("AWS_ACCESS_KEY_ID")
        secret, token = known["AWS_SECRET_ACCESS_KEY"], known.get("AWS_SESSION_TOKEN")
    elif access is None and endpoint.profile not in (None, DEFAULT):
        found = session_of(endpoint.profile, endpoint.names.profile).get_credentials()
        if found is not None:
            frozen = found.get_frozen_credentials()
            access, secret, token = frozen.access_key, frozen.secret_key, frozen.token
    if access is not None:
        options |= {"access_key": access, "secret_key": secret, "session_token": token}
    return S3FileSystem(**options)
