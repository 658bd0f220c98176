"""Hides access keys, passwords and tokens from a racer's code.

A process that calls a reward function gets them through a pipe: that code could print the
environment, which `/proc` shows to every process of the user. They are lent to the AWS library.
"""

import ctypes
import os
import re
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

from drcli.config.fields import hidden

_MORE = re.compile(r"PASSPHRASE|PRIVATE_?KEY|AUTHORIZATION|_PASS$|^RCLONE_AUTH_KEY$", re.IGNORECASE)
_PR_SET_DUMPABLE = 4

_kept: dict[str, str] = {}
_lock = threading.RLock()
_lendings = 0


def split(environment: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """The harmless and the secret variables."""
    with _lock:  # another thread may just be lending
        everything = dict(environment)
    secret = {name: value for name, value in everything.items() if is_secret(name, value)}
    return {n: v for n, v in everything.items() if n not in secret}, secret


def all_secrets() -> dict[str, str]:
    with _lock:
        return {**_kept, **split(os.environ)[1]}


def keep(secrets: Mapping[str, str]) -> None:
    """Keep the secrets that this process was given."""
    with _lock:
        _kept.update(secrets)


@contextmanager
def lent() -> Iterator[None]:
    """Put the secrets into the environment, for the AWS library."""
    global _lendings
    with _lock:
        _lendings += 1
        for name, value in _kept.items():
            os.environ.setdefault(name, value)
    try:
        yield
    finally:
        with _lock:
            _lendings -= 1
            if not _lendings:
                for name in _kept:
                    os.environ.pop(name, None)


def hide_process() -> None:
    """Let no other process of this user read memory and environment of this one; only on Linux.

    Root may read the memory anyway, so the environment that `/proc` shows is overwritten too.
    """
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError, ValueError):
        library = ctypes.CDLL(None)
        library.prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0)
        _overwrite(library, split(os.environ)[1])


def _overwrite(library: ctypes.CDLL, secrets: Mapping[str, str]) -> None:
    block = ctypes.POINTER(ctypes.c_void_p).in_dll(library, "environ")
    index = 0
    while (address := block[index]) is not None:
        entry = ctypes.string_at(address)
        name, _, value = entry.partition(b"=")
        if os.fsdecode(name) in secrets:
            ctypes.memset(address + len(name) + 1, ord("*"), len(value))
        index += 1
    for each, text in secrets.items():
        os.environ[each] = text  # in other memory


def is_secret(name: str, value: str) -> bool:
    if name.endswith("_FILE"):
        return False
    return bool(value) and (hidden(name, value) != value or _MORE.search(name) is not None)
