"""Ray, which is an extra and may be missing: whether it is there, and whether it has a cluster."""

import importlib.util
import os

from drcli.base.errors import NotAvailable
from drcli.config.settings import Settings

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


def has_cluster(settings: Settings) -> bool:
    """Whether Ray has an address; otherwise it starts on this machine, and knows no other."""
    return bool(settings.ray_address or os.environ.get("RAY_ADDRESS"))


def workers_here(settings: Settings) -> int:
    """How many simulation workers a training starts on this machine."""
    elsewhere = settings.launcher == "ray" and has_cluster(settings)
    return 0 if elsewhere else settings.workers
