"""Ray, which is an extra and may be missing."""

import importlib.util

from drcli.base.errors import NotAvailable


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
