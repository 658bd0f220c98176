"""Libraries of the extra `analysis`, which take a second to load and may be missing."""

from types import ModuleType

from drcli.base.errors import NotAvailable

REMEDY = "Install it: `pip install 'drcli[analysis]'`."


def deepracer_logs() -> ModuleType:
    """The package deepracer.logs of deepracer-utils.

    Raises:
        NotAvailable: It, or pandas, is not installed.
    """
    import os

    # The library loads matplotlib.pyplot, which must not look for a display.
    os.environ.setdefault("MPLBACKEND", "Agg")
    try:
        import deepracer.logs as logs
    except ImportError as error:
        raise NotAvailable(
            f"The analysis needs deepracer-utils and pandas ({error}).", remedy=REMEDY
        ) from error
    return logs  # type: ignore[no-any-return]
