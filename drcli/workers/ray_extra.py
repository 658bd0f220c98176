"""Whether Ray, an extra, is installed, and whether it has a cluster."""

import importlib.util
import os

from drcli.base.errors import NotAvailable
from drcli.config.settings import Settings


def require_ray() -> None:
    if importlib.util.find_spec("ray") is None:
        raise NotAvailable(
            "DR_LAUNCHER=ray needs Ray, which is not installed.",
            remedy="Install the extra: `pip install 'drcli[ray]'`.",
        )


def has_cluster(settings: Settings) -> bool:
    """Otherwise Ray starts on this machine, and knows no other."""
    return bool(settings.ray_address or os.environ.get("RAY_ADDRESS"))


def workers_here(settings: Settings) -> int:
    elsewhere = settings.launcher == "ray" and has_cluster(settings)
    return 0 if elsewhere else settings.workers
