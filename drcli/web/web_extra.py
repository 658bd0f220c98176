"""The libraries of the extra `web`, which may be missing."""

import importlib.util

from drcli.base.errors import NotAvailable

_NEEDED = ("starlette", "uvicorn", "websockets")


def require_web() -> None:
    """Raise NotAvailable if a library is missing."""
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise NotAvailable(
            f"The console needs {' and '.join(missing)}.",
            remedy="Install the extra: `pip install 'drcli[web]'`.",
        )
