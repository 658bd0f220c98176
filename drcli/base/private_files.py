"""Who may read what drcli writes.

There may be secrets, so everything is for its user alone, but files that a racer asks for get the
racer's own umask (`hand_out`).
"""

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SETTINGS = re.compile(r".*\.env(\.bak\d*)?")
_racers: int | None = None
"""While the process has another."""


@contextmanager
def private(shared: Path) -> Iterator[None]:
    """Create files for this user alone, also in started processes.

    A group keeps its rights if `shared` has the setgid bit.
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
    """Give a new file the rights of the racer's umask.

    Nobody gets rights who cannot enter its folder. Settings stay private.
    """
    given = 0o777 if path.is_dir() else 0o666
    enters = 7 * (path.parent.stat().st_mode & 0o111)
    path.chmod(given & ~_racers_umask() & enters)


def is_settings(path: Path) -> bool:
    return _SETTINGS.fullmatch(path.name) is not None


def make_folder(path: Path) -> None:
    """Handed out, like those above it."""
    if not path.parent.exists():
        make_folder(path.parent)
    if not path.is_dir():
        path.mkdir(exist_ok=True)
        hand_out(path)


def others_may_read(path: Path) -> bool:
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
