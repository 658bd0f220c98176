"""The variables that activation sets in a shell, and which of them count.

Scripts need every setting as a variable, such as `$DR_LOCAL_S3_BUCKET`. The commands read the
files, and a copy in the environment must not override a line that was edited since. So activation
marks its copies, and the commands ignore each copy that still has the marked value. If a racer
exports another value, that value wins.
"""

import zlib
from collections.abc import Mapping
from pathlib import Path

MARK = "DR_ACTIVATED"
"""Variable that lists the copies as `NAME:checksum`, with spaces between."""

FOLDER = "DR_DIR"
"""Variable that names the working folder."""

RUN_FILE = "DR_CONFIG"
"""Variable that names its run.env. Source: the reference's activation."""

EXPERIMENT = "DR_EXPERIMENT_NAME"
"""Variable that names an experiment in it."""

PLACES = (FOLDER, EXPERIMENT, "DR_RUN_ID", "DR_LOCAL_S3_MODEL_PREFIX")
"""Variables that decide which training a command finds."""


def marked(copies: Mapping[str, str]) -> str:
    """The value of the mark for these copies."""
    return " ".join(f"{name}:{_checksum(value)}" for name, value in copies.items())


def copies(environ: Mapping[str, str]) -> set[str]:
    """Names that activation exported and that have not been changed since."""
    pairs = (pair.rpartition(":") for pair in environ.get(MARK, "").split())
    return {
        name
        for name, _, checksum in pairs
        if name in environ and checksum == _checksum(environ[name])
    }


def chosen(environ: Mapping[str, str]) -> dict[str, str]:
    """The environment without the copies that activation made."""
    left = {MARK, *copies(environ)}
    return {name: value for name, value in environ.items() if name not in left}


def places(environ: Mapping[str, str]) -> dict[str, str]:
    """The variables of `PLACES` that were set by hand, neither by a file nor by activation.

    They may have been set for one command only, as in `DR_RUN_ID=3 dr-start-training`; the next
    one needs them again.
    """
    left = copies(environ) | _activated(environ)
    return {name: environ[name] for name in PLACES if name in environ and name not in left}


def run_file(environ: Mapping[str, str], directory: Path) -> str:
    """The run.env that an activated shell asks for if no experiment is chosen.

    `run.env`, or the path of another file, below the folder or absolute. A shell that was activated
    for another working folder does not count.
    """
    folder, file = environ.get(FOLDER), environ.get(RUN_FILE)
    if not folder or not file or Path(folder).absolute() != directory:
        return "run.env"
    path = directory / file
    if not path.is_relative_to(directory):
        return str(path)
    name = path.relative_to(directory)
    return "run.env" if name.parts[0] == "experiments" else str(name)


def _activated(environ: Mapping[str, str]) -> set[str]:
    """Whether folder and experiment are still those for which the shell was activated."""
    folder, file = environ.get(FOLDER), environ.get(RUN_FILE)
    if not folder or not file:
        return set()
    place = Path(file).parent
    if place.parent == Path(folder, "experiments"):
        return {FOLDER, EXPERIMENT} if environ.get(EXPERIMENT) == place.name else {FOLDER}
    return {FOLDER} if place == Path(folder) else set()


def _checksum(value: str) -> str:
    return format(zlib.crc32(value.encode("utf-8", "surrogateescape")), "08x")
