"""Ray, which is an extra and may be missing, and its cluster."""

import importlib.util
import os
import signal
import socket
from typing import Any

from drcli.base.errors import NotAvailable, SettingsError

KEYS = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
"""Keys of the bucket that nodes get if the environment of the command has them."""

_OF_TUNE = ("pandas", "pyarrow", "fsspec")
"""What Ray Tune imports besides Ray."""


def require_ray() -> None:
    """Check that Ray is installed.

    Raises:
        NotAvailable: It is not.
    """
    if importlib.util.find_spec("ray") is None:
        raise NotAvailable(
            "DR_LAUNCHER=ray needs Ray, which is not installed.",
            remedy="Install the extra: `pip install 'drcli[ray]'`.",
        )


def require_tune() -> None:
    """Check that Ray Tune is installed: Ray, and what Tune needs besides.

    Raises:
        NotAvailable: Something is missing.
    """
    require_ray()
    missing = [name for name in _OF_TUNE if importlib.util.find_spec(name) is None]
    if missing:
        raise NotAvailable(
            f"Ray Tune, which runs sweeps with DR_LAUNCHER=ray, needs {' and '.join(missing)}.",
            remedy="Install the extra: `pip install 'drcli[ray]'`.",
        )


def connect(address: str, cloud: str) -> Any:
    """Connect with a cluster of Ray, or start Ray on this machine.

    Args:
        address: Of the cluster; empty for that of RAY_ADDRESS, or this machine alone.
        cloud: DR_CLOUD, which says who reaches the bucket.

    Returns:
        The module `ray`.

    Raises:
        NotAvailable: Ray is not installed.
        SettingsError: The cluster does not answer, or its other machines cannot reach the bucket.
    """
    require_ray()
    import ray as module

    ray: Any = module
    ended_by = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(
            # Without an address, Ray would join any cluster that it finds on this machine.
            address=address or os.environ.get("RAY_ADDRESS") or "local",
            include_dashboard=None if address else False,
            logging_level="ERROR",
            log_to_driver=False,
            configure_logging=False,
            namespace="drcli",
        )
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise SettingsError(
            f"Ray at {address or 'RAY_ADDRESS'} does not answer: {str(error).splitlines()[0]}",
            remedy="Correct DR_RAY_ADDRESS, or start the cluster with `ray up` or `ray start "
            "--head`.",
        ) from None
    finally:
        signal.signal(signal.SIGTERM, ended_by)  # Ray has its own, which ends the process
    hosts = {node["NodeManagerHostname"] for node in ray.nodes() if node["Alive"]}
    others = hosts - {socket.gethostname()}
    if others and cloud == "local":
        ray.shutdown()
        raise SettingsError(
            f"DR_CLOUD=local is a bucket on this machine, which {min(others)} cannot reach.",
            remedy="Use a bucket that all nodes reach: DR_CLOUD=aws or remote.",
        )
    return ray
