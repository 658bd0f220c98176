"""Arguments and variables of the aws command for the bucket."""

from collections.abc import Mapping, Sequence

from drcli.config.bucket_config import StorageConfig
from drcli.store.server import server

_COMPATIBLE = {
    # Not all other servers know Amazon's newer checksums.
    "AWS_REQUEST_CHECKSUM_CALCULATION": "when_required",
    "AWS_RESPONSE_CHECKSUM_VALIDATION": "when_required",
}

_OTHER_KEYS = ("AWS_PROFILE", "AWS_DEFAULT_PROFILE", "AWS_SESSION_TOKEN", "AWS_SECURITY_TOKEN")


def aws_command(
    storage: StorageConfig,
    arguments: Sequence[str],
    environ: Mapping[str, str],
) -> tuple[list[str], dict[str, str]]:
    """May start the local server. Keys are variables: every user can read a command line."""
    endpoint = server.ensure_running(storage)
    options: list[str] = []
    variables = {**environ, "AWS_DEFAULT_REGION": endpoint.region}
    if endpoint.url is not None:
        options += ["--endpoint-url", endpoint.url]
        variables |= _COMPATIBLE
    if endpoint.access_key is not None and endpoint.secret_key is not None:
        variables = {name: value for name, value in variables.items() if name not in _OTHER_KEYS}
        variables["AWS_ACCESS_KEY_ID"] = endpoint.access_key
        variables["AWS_SECRET_ACCESS_KEY"] = endpoint.secret_key
    elif endpoint.profile is not None:
        options += ["--profile", endpoint.profile]
    return [*options, *arguments], variables
