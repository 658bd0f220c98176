"""Downloads the community's route files."""

import difflib
import http.client
import re
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import quote, urlsplit

from drcli.base.errors import NoAnswer, SettingsError, StorageError
from drcli.config.track_names import COMMUNITY, hint
from drcli.tracks.track_facts import TrackFacts
from drcli.tracks.tracks_folder import add_track, target_of

PATIENCE_S = 20.0
_MOST_BYTES = 1_000_000
_PIECE = 65_536
_LATER = (408, 429)
"""Request timeout and too many requests: answers to give the same request again."""

_HANDLERS = (
    urllib.request.ProxyHandler,
    urllib.request.HTTPHandler,
    urllib.request.HTTPSHandler,
    urllib.request.HTTPRedirectHandler,
    urllib.request.HTTPDefaultErrorHandler,
    urllib.request.HTTPErrorProcessor,
    urllib.request.UnknownHandler,
)
"""Redirects must not lead to ftp, file or data addresses."""

_GITHUB = re.compile(r"https://raw\.githubusercontent\.com/([^/]+/[^/]+)/([^/]+)/(.+)")
_LISTED = re.compile(r"([A-Za-z0-9_][A-Za-z0-9_-]*)\.npy\b")


def fetch_track(
    name: str, url: str, folder: Path, *, called: str | None = None, replace: bool = False
) -> TrackFacts:
    """Download NAME.npy from a web folder, check it and keep it.

    Raises:
        SettingsError: The name is wrong or taken, or address or file unusable.
        NoAnswer: The server cannot be reached or is too busy.
        StorageError: It has no such file, or sends too much.
    """
    name = name.removesuffix(".npy")
    called = called or name
    url = _address(url)
    target_of(called, folder, replace=replace)
    address = f"{url}/{quote(name, safe='')}.npy"
    likely = "" if name in COMMUNITY else hint(name, folder)
    try:
        content = _download(address)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == 404:
            raise StorageError(
                f"There is no track {name} at {address}.", remedy=likely + _similar(name, url)
            ) from None
        reason = " ".join(str(error.reason).split())  # a redirect in a circle gives three lines
        kind = NoAnswer if error.code in _LATER or error.code >= 500 else StorageError
        raise kind(
            f"{address} answered {error.code} {reason}.",
            remedy="Try again later, or fetch it from another address with --from.",
        ) from None
    except (OSError, ValueError, http.client.HTTPException) as error:
        raise NoAnswer(
            f"{address} cannot be reached: {_reason(error)}.",
            remedy=f"{likely}Check the network and repeat `dr-tracks fetch {name}`, or add your "
            "own file with `dr-tracks add FILE.npy`.",
        ) from None
    if len(content) > _MOST_BYTES:
        raise StorageError(
            f"{address} is larger than {_MOST_BYTES} bytes, so it is not a route.",
            remedy="Fetch it from another address with --from.",
        )
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / f"{called}.npy"
        file.write_bytes(content)
        try:
            return add_track(file, folder, name=called, replace=replace)
        except SettingsError as error:
            text = str(error).replace(str(file), address)
            raise SettingsError(text, remedy="Fetch it from another address with --from.") from None


def _address(url: str) -> str:
    try:
        parts = urlsplit(url)
        good = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:  # an unclosed bracket, a port that is not a number
        good = False
    if not good or not url.isascii() or not url.isprintable() or " " in url:
        raise SettingsError(
            f"{url!r} (--from or DR_TRACKS_URL) is not a web address.",
            remedy="Write an address such as https://example.org/routes, or leave it out.",
        )
    return url.rstrip("/")


def _download(address: str) -> bytes:
    deadline = time.monotonic() + PATIENCE_S
    pieces, size = [], 0
    opener = urllib.request.OpenerDirector()
    for handler in _HANDLERS:
        opener.add_handler(handler())
    with opener.open(address, timeout=PATIENCE_S) as answer:
        while size <= _MOST_BYTES and (piece := answer.read1(_PIECE)):
            pieces.append(piece)
            size += len(piece)
            if time.monotonic() > deadline:
                raise TimeoutError(f"it takes longer than {PATIENCE_S:.0f} s")
    return b"".join(pieces)[: _MOST_BYTES + 1]


def _reason(error: Exception) -> str:
    cause = getattr(error, "reason", error)
    return str(getattr(cause, "strerror", None) or cause)


def _similar(name: str, url: str) -> str:
    listing = url + "/"
    if match := _GITHUB.fullmatch(url):
        repository, version, path = match.groups()
        listing = f"https://api.github.com/repos/{repository}/contents/{path}?ref={version}"
    try:
        text = _download(listing).decode("utf-8", "replace")
    except (OSError, ValueError, http.client.HTTPException):  # not every server lists its files
        text = ""
    by_lower = {found.lower(): found for found in _LISTED.findall(text)}
    close = difflib.get_close_matches(name.lower(), by_lower, n=5, cutoff=0.5)
    if not close:
        return "Correct the name; upper and lower case matter, as in Oval_track."
    names = ", ".join(by_lower[found] for found in close)
    return f"The closest names there are {names}; upper and lower case matter."
