"""Locks between processes, which the system releases at their end."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drcli.base.backoff import wait_until
from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.system_calls import try_lock

PATIENCE_S = 30.0


@contextmanager
def exclusive(
    path: Path,
    *,
    patience_s: float,
    what: str = "the local S3 server",
    failure: type[DrError] = StorageError,
) -> Iterator[None]:
    """Hold a lock file, which is created if needed and never deleted.

    Raises:
        StorageError: Another command held it for `patience_s`; or another `failure`.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    with _held(descriptor, f"{what} ({path})", patience_s, failure):
        yield


@contextmanager
def only_writer(directory: Path) -> Iterator[None]:
    """Lock a working folder against other commands.

    Raises:
        SettingsError: It is unreadable, or was in use for `PATIENCE_S`.
    """
    try:
        descriptor = os.open(directory, os.O_RDONLY)
    except OSError as e:
        raise SettingsError(
            f"{directory}: cannot be read ({e.strerror or e}).",
            remedy="Change to the folder that holds run.env.",
        ) from e
    with _held(descriptor, f"the folder {directory}", PATIENCE_S, SettingsError):
        yield


@contextmanager
def _held(descriptor: int, what: str, patience_s: float, failure: type[DrError]) -> Iterator[None]:
    try:
        if not wait_until(
            lambda: try_lock(descriptor),
            patience_s=patience_s,
            first_s=0.01,
            last_s=0.2,
            what=f"Waiting for another command that is using {what} ...",
        ):
            raise failure(
                f"Another command has been using {what} for {patience_s:.0f} s.",
                remedy="Wait until it has ended, or end it, and run this command again.",
            )
        yield
    finally:
        os.close(descriptor)


def leads_to(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError:
        return False
