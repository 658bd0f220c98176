"""Secrets that nobody has, and a search for them wherever they could have got to."""

import base64
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, quote_plus

import psutil

MARK = "cAnArY"
"""In every secret, so that one search finds all of them."""


def canary(name: str) -> str:
    """A secret with letters that encodings change, as keys of Amazon have them."""
    return f"{MARK}/{name}+a=b&c"


def disguises(secret: str) -> set[bytes]:
    """A secret as texts may hold it: as it is, in JSON, addresses, base64, hexadecimals."""
    plain = secret.encode()
    found = {plain, plain.hex().encode(), plain.hex().upper().encode()}
    found |= {json.dumps(secret)[1:-1].encode(), secret.replace("/", "\\/").encode()}
    found |= {quote(secret, safe="").encode(), quote(secret).encode(), quote_plus(secret).encode()}
    for encode in (base64.b64encode, base64.urlsafe_b64encode):
        for before in range(3):  # by where it begins in the text that was encoded
            encoded = encode(b"\0" * before + plain)
            first = (0, 2, 3)[before]
            found.add(encoded[first : len(encoded) // 4 * 4 - 4])
    return found


_MARKS = disguises(f"{MARK}/")


@dataclass(frozen=True)
class Sighting:
    """A secret, and where it was found."""

    secret: str
    where: str


def sightings(text: bytes | str, where: str, secrets: Mapping[str, str]) -> list[Sighting]:
    """The secrets in a text."""
    data = text.encode("utf-8", "surrogateescape") if isinstance(text, str) else text
    marked = all(secret.startswith(MARK) for secret in secrets.values())
    if marked and not any(disguise in data for disguise in _MARKS):
        return []  # the usual case, found quickly
    return [
        Sighting(name, where)
        for name, secret in secrets.items()
        if any(disguise in data for disguise in disguises(secret))
    ]


def in_files(folder: Path, secrets: Mapping[str, str], known: set[Path]) -> list[Sighting]:
    """The secrets in all files below a folder, but those where somebody has put them."""
    found = []
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path not in known:
            where = str(path.relative_to(folder))
            found += sightings(path.read_bytes(), where, secrets) + sightings(where, where, secrets)
    return found


def in_processes(secrets: Mapping[str, str]) -> list[Sighting]:
    """The secrets in what any process of this machine shows of itself to others of its user."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error, OSError):
            line = " ".join(process.cmdline())
            environment = "\n".join(f"{k}={v}" for k, v in process.environ().items())
            found += sightings(line, f"command line of {process.pid}: {line[:200]}", secrets)
            found += sightings(environment, f"environment of {process.pid}: {line[:200]}", secrets)
    return found
