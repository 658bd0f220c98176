"""The bucket as a file system of Apache Arrow, which Ray Tune writes to."""

from typing import Any

from drcli.config import secret_environment
from drcli.config.bucket_config import StorageConfig
from drcli.store.profiles import DEFAULT, session_of
from drcli.store.server import server


def arrow_files(storage: StorageConfig) -> Any:
    """The file system; its paths begin with the name of the bucket.

    It can be sent to other machines. They get keys that come from the environment or a profile;
    without these, Arrow looks on each machine for its own, such as those of its role.

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
