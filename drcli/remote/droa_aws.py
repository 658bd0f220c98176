"""Clients of Amazon's services, and their failures."""

from functools import cache
from typing import TYPE_CHECKING, Any

from drcli.base.errors import StorageError
from drcli.remote.droa_keys import Keys
from drcli.remote.droa_site import Site
from drcli.remote.web_request import CONNECT_TIMEOUT_S, READ_TIMEOUT_S, USER_AGENT
from drcli.store.s3_errors import error_code, error_text

if TYPE_CHECKING:
    from botocore.session import Session


def aws_client(service: str, site: Site, keys: Keys | None = None) -> Any:
    """With these temporary keys, or none.

    Settings of AWS belong to other buckets, so they are ignored.
    """
    from botocore import UNSIGNED
    from botocore.config import Config

    config = Config(
        region_name=site.region,
        signature_version=UNSIGNED if keys is None else None,
        retries={"total_max_attempts": 4, "mode": "standard"},
        connect_timeout=CONNECT_TIMEOUT_S,
        read_timeout=READ_TIMEOUT_S,
        user_agent_extra=USER_AGENT,
    )
    return _session().create_client(
        service,
        endpoint_url=site.aws_endpoint_url or None,
        aws_access_key_id=None if keys is None else keys.access_key,
        aws_secret_access_key=None if keys is None else keys.secret_key,
        aws_session_token=None if keys is None else keys.session_token,
        config=config,
    )


@cache
def _session() -> "Session":
    """Keeps descriptions of services, slow to load."""
    from botocore.session import Session

    # Each is (name in the files, variable, default, type).
    no_files = {"profile": (None, None, None, None), "config_file": (None, None, None, None)}
    own_address = {"ignore_configured_endpoint_urls": (None, None, True, None)}
    return Session(session_vars={**no_files, **own_address})


def aws_failure(error: Exception, action: str, site: Site) -> StorageError:
    """`action` is read after "Cannot"."""
    from botocore import exceptions as boto

    where = site.aws_endpoint_url or f"Amazon in {site.region}"
    if isinstance(error, boto.ClientError):
        return StorageError(
            f"Cannot {action}: {error_text(error)} ({error_code(error)}).",
            remedy="Try again later; if it fails again, ask who runs that DeepRacer on AWS.",
        )
    if isinstance(error, boto.SSLError):
        return StorageError(
            f"Cannot {action}: the certificate of {where} is not valid.",
            remedy="Check the clock of this machine; behind a company's proxy, set AWS_CA_BUNDLE "
            "to its certificate.",
        )
    timeouts = (boto.ConnectTimeoutError, boto.ReadTimeoutError)
    if isinstance(error, timeouts):
        return StorageError(
            f"Cannot {action}: {where} does not answer in time.",
            remedy="Check the network, and try again later.",
        )
    if isinstance(error, boto.ConnectionError | boto.HTTPClientError):
        return StorageError(
            f"Cannot {action}: {where} cannot be reached.",
            remedy="Check the network connection and the region of the site.",
        )
    return StorageError(
        f"Cannot {action}: {error_text(error)}.",
        remedy="Check the address of the site, and the options that replace its values.",
    )
