"""What a racer's reward function may reach, wherever it is called: docs/security.md."""

import os
import sys
import sysconfig
import tempfile
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from drcli.base import signal_guard
from drcli.base.confinement import FREEDOMS, Freedom, confine

_SYSTEM = (
    *("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/opt", "/nix"),
    *("/proc", "/sys", "/etc/alternatives", "/etc/ld.so.cache", "/etc/ld.so.conf"),
    *("/etc/ld.so.conf.d", "/etc/localtime", "/etc/timezone", "/etc/passwd", "/etc/group"),
    *("/etc/nsswitch.conf", "/etc/hosts", "/etc/os-release", "/etc/mime.types", "/etc/fonts"),
)
"""Programs, libraries and facts. The kernel itself keeps the memory and environment of other
processes, which are below /proc, from a confined one."""

SCRATCH = "tmp"
"""Folder for temporary files in the folder of the file."""

_DEVICES = ("null", "zero", "full", "random", "urandom", "shm", "tty")

_SECRET = ("data", "*.env", ".*", "experiments/*/*.env")
"""What no reward function reads in a working folder: bucket, logs, settings, hidden files."""

_BUCKETS = ("*/.server.json", "*/*/.server.json")
"""Beside the buckets of a local server, wherever DR_S3_DATA_DIR puts them."""

_WORDS: dict[Freedom, str] = {
    "files": "reads and writes whatever your user may",
    "sockets": "can use the network",
    "signals": "can send signals to other programs of your user",
}


def confine_reward(own: Path) -> set[Freedom]:
    """Confine this process to what a reward function needs, before it is loaded.

    It can read programs, libraries, installed packages and the working folder, which is the current
    one, but for its secrets. It can write to its own folder, the temporary ones and the working
    folder.

    Args:
        own: Its folder, with its file.

    Returns:
        What the system could not take from it.
    """
    here, scratch = Path.cwd().resolve(), own / SCRATCH
    scratch.mkdir(exist_ok=True)
    shared = Path(tempfile.gettempdir()).resolve()
    os.environ["TMPDIR"] = tempfile.tempdir = str(scratch)
    secret = {path.resolve() for path in _secrets(here, shared)}
    caches = [Path(os.environ[name]) for name in ("NUMBA_CACHE_DIR",) if os.environ.get(name)]
    signal_guard.install()
    return confine(
        _parts([*map(Path, _SYSTEM), *_python()], secret),
        [
            own.resolve(),
            *(Path("/dev", name) for name in _DEVICES),
            *_parts([here, shared, *caches], secret),
        ],
        [here, shared],
    )


def freedoms_told(left: Collection[Freedom]) -> str:
    """What a reward function may still do, as a sentence; empty if it is confined."""
    if not left:
        return ""
    what = ", ".join(_WORDS[each] for each in FREEDOMS if each in left)
    return f"The reward function {what}: this system cannot prevent it (docs/security.md)."


def _python() -> Iterator[Path]:
    """Where Python, its libraries and installed packages are."""
    places = [sys.prefix, sys.base_prefix, sys.exec_prefix, *sys.path]
    places += sysconfig.get_paths().values()
    yield from {Path(place).resolve() for place in places if place}


def _secrets(here: Path, shared: Path) -> Iterator[Path]:
    """Files and folders that may lie inside of what is allowed."""
    for pattern in _SECRET:
        yield from here.glob(pattern)
    for pattern in _BUCKETS:
        yield from (found.parent for root in (here, shared) for found in root.glob(pattern))
    with suppress(RuntimeError):  # nobody knows the home
        yield from Path.home().glob(".*")
    for name, value in os.environ.items():
        if name.endswith("_FILE") and value:
            yield Path(value)


def _parts(roots: Iterable[Path], secret: Collection[Path]) -> Iterator[Path]:
    """The roots; of those that contain something secret, what is in them besides."""
    for root in roots:
        inside = [each for each in secret if each != root and each.is_relative_to(root)]
        yield from _parts(_harmless(root, inside), inside) if inside else [root]


def _harmless(folder: Path, secret: Collection[Path]) -> Sequence[Path]:
    try:
        entries = list(folder.iterdir())
    except OSError:
        return []
    found = []
    for entry in entries:
        real = entry.resolve()
        leads_up = real != entry and any(each.is_relative_to(real) for each in secret)
        if not leads_up and not any(real.is_relative_to(each) for each in secret):
            found.append(real)
    return found
