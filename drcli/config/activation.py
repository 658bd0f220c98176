"""The variables that activation sets in a shell, and which of them count.

Scripts need every setting as a variable, but a copy must not override a line that was edited
since. So activation marks its copies, and the commands ignore those that still have the marked
value.
"""

import zlib
from collections.abc import Mapping
from pathlib import Path

MARK = "DR_ACTIVATED"
"""Lists the copies as `NAME:checksum`, with spaces between."""

FOLDER = "DR_DIR"
RUN_FILE = "DR_CONFIG"
"""Names its run.env. Source: the reference's activation."""

EXPERIMENT = "DR_EXPERIMENT_NAME"
MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
BUCKET = ("DR_CLOUD", "DR_REMOTE_MINIO_URL", "DR_LOCAL_S3_PROFILE", "DR_LOCAL_S3_BUCKET")
PLACES = (FOLDER, EXPERIMENT, "DR_RUN_ID", *BUCKET, MODEL)
"""They decide which training and which model a command finds."""


def marked(copies: Mapping[str, str]) -> str:
    return " ".join(f"{name}:{_checksum(value)}" for name, value in copies.items())


def copies(environ: Mapping[str, str]) -> set[str]:
    """Exported by activation and not changed since."""
    pairs = (pair.rpartition(":") for pair in environ.get(MARK, "").split())
    return {
        name
        for name, _, checksum in pairs
        if name in environ and checksum == _checksum(environ[name])
    }


def chosen(environ: Mapping[str, str]) -> dict[str, str]:
    """The environment without these copies."""
    left = {MARK, *copies(environ)}
    return {name: value for name, value in environ.items() if name not in left}


def places(environ: Mapping[str, str]) -> dict[str, str]:
    """The variables of `PLACES` that were set by hand, maybe for one command only.

    Not a value with a password, as an address can have it.
    """
    left = copies(environ) | _activated(environ)
    found = {name: environ[name] for name in PLACES if name in environ and name not in left}
    return {name: value for name, value in found.items() if name not in BUCKET or "@" not in value}


def run_file(environ: Mapping[str, str], directory: Path) -> str:
    """The run.env of an activated shell, if it was activated for this folder."""
    folder, file = environ.get(FOLDER), environ.get(RUN_FILE)
    if not folder or not file or Path(folder).absolute() != directory:
        return "run.env"
    path = directory / file
    if not path.is_relative_to(directory):
        return str(path)
    name = path.relative_to(directory)
    return "run.env" if name.parts[0] == "experiments" else str(name)


def _activated(environ: Mapping[str, str]) -> set[str]:
    folder, file = environ.get(FOLDER), environ.get(RUN_FILE)
    if not folder or not file:
        return set()
    place = Path(file).parent
    if place.parent == Path(folder, "experiments"):
        return {FOLDER, EXPERIMENT} if environ.get(EXPERIMENT) == place.name else {FOLDER}
    return {FOLDER} if place == Path(folder) else set()


def _checksum(value: str) -> str:
    return format(zlib.crc32(value.encode("utf-8", "surrogateescape")), "08x")
