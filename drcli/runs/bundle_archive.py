"""Writes the archive of a support bundle, and searches it for secrets."""

import gzip
import io
import os
import tarfile
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.runs.redaction import Redactor

FOLDER = "drcli-support"


def check_writable(target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as error:
        raise _unwritable(target, error) from error


def write_checked(target: Path, texts: Mapping[str, str], redactor: Redactor) -> None:
    """Write the archive, search it for secrets, and only then give it its name.

    Raises:
        SettingsError: It cannot be written, or a secret was found in it.
    """
    try:
        number, scratch = tempfile.mkstemp(prefix=f".{target.name}-", dir=target.parent)
    except OSError as error:
        raise _unwritable(target, error) from error
    try:
        with os.fdopen(number, "wb") as file:
            file.write(_archive(texts))
        leaks = _leaks(Path(scratch), redactor)
        if leaks:
            raise SettingsError(
                f"The bundle would contain a secret: {'; '.join(leaks[:5])}.",
                remedy="No bundle was written. Report this as a fault of drcli, without the file.",
            )
        Path(scratch).replace(target)
    except OSError as error:
        raise _unwritable(target, error) from error
    finally:
        Path(scratch).unlink(missing_ok=True)


def _archive(texts: Mapping[str, str]) -> bytes:
    packed = io.BytesIO()
    now = int(time.time())
    with (
        gzip.GzipFile(filename="", fileobj=packed, mode="wb", mtime=now) as compressed,
        tarfile.open(fileobj=compressed, mode="w", format=tarfile.PAX_FORMAT) as archive,
    ):
        for name, text in texts.items():
            data = text.encode()
            entry = tarfile.TarInfo(f"{FOLDER}/{name}")
            entry.size, entry.mtime, entry.mode = len(data), now, 0o644
            archive.addfile(entry, io.BytesIO(data))
    return packed.getvalue()


def _leaks(path: Path, redactor: Redactor) -> list[str]:
    found = []
    with tarfile.open(path) as archive:
        for entry in archive:
            content = archive.extractfile(entry)
            text = "" if content is None else content.read().decode()
            found += [f"{entry.name}: {kind}" for kind in redactor.leaks(text)]
            found += [f"a file name: {kind}" for kind in redactor.leaks(entry.name)]
    return found


def _unwritable(target: Path, error: OSError) -> SettingsError:
    return SettingsError(
        f"{target}: the bundle cannot be written ({error.strerror or error}).",
        remedy="Name a file in a folder that you can write.",
    )
