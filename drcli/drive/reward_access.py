"""What a racer's reward function may reach: docs/security.md."""

import os
import sys
import sysconfig
import tempfile
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from drcli.base import confinement
from drcli.base.confinement import FREEDOMS, Freedom, confine
from drcli.base.files import find_files

_SYSTEM = (
    *("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/opt", "/nix"),
    *("/proc", "/sys", "/etc/alternatives", "/etc/ld.so.cache", "/etc/ld.so.conf"),
    *("/etc/ld.so.conf.d", "/etc/localtime", "/etc/timezone", "/etc/passwd", "/etc/group"),
    *("/etc/nsswitch.conf", "/etc/hosts", "/etc/os-release", "/etc/mime.types", "/etc/fonts"),
)
"""The kernel itself keeps memory and environment of other processes below /proc."""

SCRATCH = "tmp"
_DEVICES = ("null", "zero", "full", "random", "urandom", "shm", "tty")

_SECRET = ("data", "*.env", ".*", "experiments/*/*.env")
"""What no reward function reads: bucket, logs, settings, hidden files."""

_BUCKETS = ("*/.server.json", "*/*/.server.json")
_WORDS: dict[Freedom, str] = {
    "files": "reads and writes whatever your user may",
    "sockets": "can use the network",
    "signals": "can send signals to other programs of your user",
}


def confine_reward(own: Path) -> set[Freedom]:
    """Confine this process before a reward function is loaded.

    It can read programs, packages and the current working folder but for its secrets, and write
    to that, to its `own` folder and to temporary ones.

    Returns:
        What the system could not take from it.
    """
    here, scratch = Path.cwd().resolve(), own / SCRATCH
    scratch.mkdir(exist_ok=True)
    shared = Path(tempfile.gettempdir()).resolve()
    os.environ["TMPDIR"] = tempfile.tempdir = str(scratch)
    secret = {path.resolve() for path in _secrets(here, shared)}
    caches = [Path(os.environ[name]) for name in ("NUMBA_CACHE_DIR",) if os.environ.get(name)]
    confinement.install()
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
    if not left:
        return ""
    what = ", ".join(_WORDS[each] for each in FREEDOMS if each in left)
    return f"The reward function {what}: this system cannot prevent it (`dr docs security`)."


def _python() -> Iterator[Path]:
    places = [sys.prefix, sys.base_prefix, sys.exec_prefix, *sys.path]
    places += sysconfig.get_paths().values()
    yield from {Path(place).resolve() for place in places if place}


def _secrets(here: Path, shared: Path) -> Iterator[Path]:
    for pattern in _SECRET:
        yield from find_files(here, pattern)
    for pattern in _BUCKETS:
        yield from (found.parent for root in (here, shared) for found in find_files(root, pattern))
    with suppress(RuntimeError):  # nobody knows the home
        yield from find_files(Path.home(), ".*")
    for name, value in os.environ.items():
        if name.endswith("_FILE") and value:
            yield Path(value)


def _parts(roots: Iterable[Path], secret: Collection[Path]) -> Iterator[Path]:
    """The roots without what is secret in them."""
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
