"""Who may read what drcli writes: its user alone, except files that are made to be handed out.

Settings, logs, records and models may contain secrets. So a command creates everything for its user
alone, and so do the processes that it starts, which inherit its umask. Reports, videos, exports and
other files that a racer asks for get the rights of the racer's own umask (`hand_out`).
"""

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SETTINGS = re.compile(r".*\.env(\.bak\d*)?")
"""Names of settings files and their copies, which may contain webhooks and passwords."""

_racers: int | None = None
"""The umask of the racer while that of the process is another."""


@contextmanager
def private(shared: Path) -> Iterator[None]:
    """Create files and folders for this user alone, here and in processes that are started.

    Args:
        shared: If this folder belongs to a group on purpose, which its setgid bit says, the group
            gets the same rights to what is created as it has to the folder.
    """
    global _racers
    try:
        mode = shared.stat().st_mode
    except OSError:
        mode = 0
    for_group = mode & 0o070 if mode & stat.S_ISGID else 0
    outer, before = _racers, os.umask(0o077 & ~for_group)
    _racers = before
    try:
        yield
    finally:
        os.umask(before)
        _racers = outer


def hand_out(path: Path) -> None:
    """Give a new file or folder the rights that the racer's umask would have given it.

    Nobody gets rights who cannot enter its folder. Settings files stay private.
    """
    given = 0o777 if path.is_dir() else 0o666
    enters = 7 * (path.parent.stat().st_mode & 0o111)
    path.chmod(given & ~_racers_umask() & enters)


def is_settings(path: Path) -> bool:
    """Whether a file is a settings file, or a copy of one."""
    return _SETTINGS.fullmatch(path.name) is not None


def make_folder(path: Path) -> None:
    """Make a folder that is handed out, and those above it, if they do not exist.

    Raises:
        OSError: One cannot be made.
    """
    if not path.parent.exists():
        make_folder(path.parent)
    if not path.is_dir():
        path.mkdir(exist_ok=True)
        hand_out(path)


def others_may_read(path: Path) -> bool:
    """Whether other users may read a file or folder, unless it is a group for which it is meant."""
    mode = path.stat().st_mode
    folder = path if path.is_dir() else path.parent
    is_meant = folder.stat().st_mode & stat.S_ISGID
    return bool(mode & (0o004 if is_meant else 0o044))


def _racers_umask() -> int:
    if _racers is not None:
        return _racers
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
