"""Checks that every package that drcli needs has a wheel for each system that we name.

    python scripts/check_wheels.py [--python 3.11 3.12 3.13] [--system NAME ...] [--json]

Asks the package index, through uv, which files an installation on another system would use, with
the versions of constraints/default.txt. No package is downloaded or installed. uv is used if it is
on the path; otherwise it is installed into a temporary folder.

Prints a line for each system and version of Python. Exits with 1 if something is missing on a
system that docs/platforms.md names as supported, and with 7 if the index cannot be reached. With
--json the last line of stdout is one object: for each system, version by version, an empty text or
what is missing.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import venv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]

PYTHONS = ("3.11", "3.12", "3.13")


@dataclass(frozen=True)
class System:
    """A system to install on.

    Attributes:
        platform: Its name in uv.
        environment: Variables that choose the version of the system.
        supported: Whether docs/platforms.md promises that an installation finds everything.
    """

    platform: str
    environment: tuple[tuple[str, str], ...] = ()
    supported: bool = True


SYSTEMS: Mapping[str, System] = {
    "Linux x86_64": System("x86_64-manylinux_2_28"),
    "Linux aarch64": System("aarch64-manylinux_2_28"),
    "macOS arm64": System("aarch64-apple-darwin", (("MACOSX_DEPLOYMENT_TARGET", "14.0"),)),
    "macOS x86_64": System(
        "x86_64-apple-darwin", (("MACOSX_DEPLOYMENT_TARGET", "14.0"),), supported=False
    ),
}
"""The systems; glibc 2.28 is that of Debian 10, Ubuntu 20.04 and Jetson's JetPack 5."""

UNREACHABLE = ("error sending request", "Failed to fetch", "Could not connect", "dns error")
"""Words by which uv says that the index does not answer."""


class NoIndex(Exception):
    """The package index cannot be reached."""


def main() -> int:
    """Check, and print a line for each combination."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--python", nargs="+", default=list(PYTHONS), choices=PYTHONS)
    parser.add_argument("--system", nargs="+", default=list(SYSTEMS), choices=SYSTEMS)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found: dict[str, dict[str, str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        try:
            uv = uv_program(Path(folder))
            for name in options.system:
                for python in options.python:
                    missing = missing_wheels(uv, SYSTEMS[name], python)
                    found.setdefault(name, {})[python] = missing
                    print(f"{name}, Python {python}: {missing or 'complete'}", flush=True)
        except NoIndex as error:
            print(error, file=sys.stderr)
            return 7
    if options.json:
        print(json.dumps(found))
    return int(any(SYSTEMS[name].supported and any(each.values()) for name, each in found.items()))


def uv_program(folder: Path) -> str:
    """The program uv; installed into the folder if it is not on the path.

    Raises:
        NoIndex: It cannot be installed.
    """
    if (found := shutil.which("uv")) is not None:
        return found
    venv.create(folder / "venv", with_pip=True)
    pip = [str(folder / "venv/bin/python"), "-m", "pip", "install", "--quiet", "uv"]
    if subprocess.run(pip, capture_output=True).returncode:
        raise NoIndex("uv cannot be installed: the package index cannot be reached.")
    return str(folder / "venv/bin/uv")


def missing_wheels(uv: str, system: System, python: str) -> str:
    """What an installation on a system would not find; empty if it finds everything.

    Raises:
        NoIndex: The package index cannot be reached.
    """
    command = [uv, "pip", "compile", "--quiet", "--no-annotate", "--no-header"]
    command += ["--only-binary", ":all:", "--python-platform", system.platform]
    command += ["--python-version", python, "--constraint", "constraints/default.txt"]
    answer = subprocess.run(
        [*command, "pyproject.toml"],
        cwd=PROJECT,
        env={**os.environ, **dict(system.environment)},
        capture_output=True,
        text=True,
    )
    if not answer.returncode:
        return ""
    if any(word in answer.stderr for word in UNREACHABLE):
        raise NoIndex("The package index cannot be reached.")
    return _reason(answer.stderr)


def _reason(text: str) -> str:
    """Uv's explanation as one line."""
    line = " ".join(text.split())
    for word in ("cause: ", "╰─▶ "):
        line = line.partition(word)[2] or line
    return line.partition(" hint: ")[0][:300]


if __name__ == "__main__":
    sys.exit(main())
