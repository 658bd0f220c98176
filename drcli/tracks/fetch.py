"""Route files of the community, fetched over HTTP."""

import tempfile
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import quote, urlsplit

from drcli.errors import SettingsError, StorageError
from drcli.tracks.folder import TrackFacts, add_track, target_of

PATIENCE_S = 20.0
_MOST_BYTES = 1_000_000


def fetch_track(name: str, url: str, folder: Path, *, replace: bool = False) -> TrackFacts:
    """Download a route, check it and put it into the folder.

    Args:
        name: Name of a world, as `Oval_track`.
        url: Folder on the web in which NAME.npy lies.
        folder: Where tracks of the racer's own lie.
        replace: Overwrite a track of that name.

    Raises:
        SettingsError: The name or the address is none, it is taken, or what came is no track.
        StorageError: The server has no such file, cannot be reached, or sends too much.
    """
    name = name.removesuffix(".npy")
    if urlsplit(url).scheme not in ("http", "https"):
        raise SettingsError(
            f"{url} (--from or DR_TRACKS_URL) is no address on the web.",
            remedy="Write it as in https://example.org/routes, or leave it out.",
        )
    target_of(name, folder, replace=replace)
    address = f"{url.rstrip('/')}/{quote(name)}.npy"
    content = _download(address, name)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / f"{name}.npy"
        file.write_bytes(content)
        try:
            return add_track(file, folder, name=name, replace=replace)
        except SettingsError as error:
            text = str(error).replace(str(file), address)
            raise SettingsError(text, remedy="Fetch it from another address with --from.") from None


def _download(address: str, name: str) -> bytes:
    try:
        with urllib.request.urlopen(address, timeout=PATIENCE_S) as answer:
            content: bytes = answer.read(_MOST_BYTES + 1)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == 404:
            raise StorageError(
                f"There is no track {name} at {address}.",
                remedy="Correct the name: upper and lower case count, as in Oval_track.",
            ) from None
        raise StorageError(
            f"{address} answered {error.code} {error.reason}.",
            remedy="Try again later, or fetch it from another address with --from.",
        ) from None
    except (urllib.error.URLError, OSError) as error:
        reason = getattr(error, "reason", error)
        raise StorageError(
            f"{address} cannot be reached: {reason}.",
            remedy="Check the network, or add a file that you have with `dr-tracks add FILE.npy`.",
        ) from None
    if len(content) > _MOST_BYTES:
        raise StorageError(
            f"{address} is larger than {_MOST_BYTES} bytes, which no route is.",
            remedy="Fetch it from another address with --from.",
        )
    return content
