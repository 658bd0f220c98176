"""Downloads files of models from DeepRacer on AWS."""

import os
import re
import tempfile
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated
from urllib.parse import unquote, urlsplit

from drcli.base.clock import Waiting
from drcli.base.errors import SettingsError, StorageError
from drcli.base.files import hand_out
from drcli.base.installation import lazy_imports
from drcli.base.report import View, size_text, table
from drcli.outside.droa.droa_api import DELETABLE, AssetType, Droa, RemoteModel
from drcli.outside.droa.droa_import import POLL_S, Progress
from drcli.outside.droa.droa_metrics import PhaseMeans
from drcli.outside.web_request import ATTEMPTS, explain, polls

with lazy_imports():
    import requests

ASSET_PATIENCE_S = 300.0
_PIECE_BYTES = 1 << 16


@dataclass(frozen=True)
class DownloadedAsset:
    """The result of `droa-download-logs`."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    model_id: Annotated[str, "Id of the model."]
    asset_type: Annotated[str, "What was downloaded, such as TRAINING_LOGS."]
    file: Annotated[str, "Where it is now."]
    file_bytes: Annotated[int, "Its size."]

    def view(self, *, means: Sequence[PhaseMeans] | None) -> View:
        what = f"{self.asset_type} of {self.model_id}"
        size = size_text(self.file_bytes)
        return [f"Downloaded {what} to {self.file}: {size}.", means and table(means)]


def find_asset(
    droa: Droa, model_id: str, kind: AssetType, evaluation_id: str, waiting: Waiting
) -> str:
    """The address of a file, once it is packed.

    Raises:
        StorageError: The server refuses, or packs it for more than five minutes.
    """
    asset = droa.asset(model_id, kind, evaluation_id)
    if asset.url:
        return asset.url
    with waiting(f"{droa.place} packs the files ..."):
        for _ in polls(POLL_S, ASSET_PATIENCE_S, droa.pause):
            if asset.url:
                return asset.url
            if asset.status != "QUEUED":
                raise StorageError(
                    f"{droa.place} has no {kind} of {model_id}: its status is "
                    f"{asset.status or 'unknown'}.",
                    remedy="Try again later.",
                )
            asset = droa.asset(model_id, kind, evaluation_id)
    raise StorageError(
        f"{droa.place} is still packing {kind} of {model_id} after "
        f"{ASSET_PATIENCE_S / 60:g} minutes.",
        remedy="Run the command again later; it goes on packing.",
    )


def download(
    droa: Droa,
    url: str,
    target: Path,
    otherwise: str,
    *,
    progress: Progress,
    replaces: Callable[[Path], None],
) -> Path:
    """Download a whole file or nothing.

    `replaces` gets an existing file, and raises to keep it.

    Raises:
        StorageError: It cannot be downloaded.
        SettingsError: It cannot be written.
    """
    file: Path | None = None
    for attempt in range(1, ATTEMPTS + 1):
        try:
            with _ask(droa, url) as answer:
                if file is None:
                    file = target / _name(answer, url, otherwise) if target.is_dir() else target
                    if file.exists():
                        replaces(file)
                with _shown(answer, file, progress) as watch:
                    _write(answer, file, watch)
            return file
        except requests.RequestException as e:  # the connection broke
            if attempt == ATTEMPTS:
                raise explain(e, url, droa.web.setting) from e
            droa.pause(float(attempt))
    raise AssertionError("the last attempt returns or raises")


def _shown(
    answer: "requests.Response", file: Path, progress: Progress
) -> AbstractContextManager[Callable[[int], None]]:
    length = answer.headers.get("Content-Length", "")
    return progress(f"Downloading {file.name}", int(length) if length.isdigit() else 0)


def _ask(droa: Droa, url: str) -> "requests.Response":
    """The address holds a signature, so no error shows it."""

    def make() -> "requests.Request":
        # Compressed on the way, the body would have another length than announced.
        return requests.Request("GET", url, headers={"Accept-Encoding": "identity"})

    answer = droa.web.send(make, repeat=True, stream=True)
    if answer.status_code == 200:
        return answer
    answer.close()
    host = urlsplit(url).netloc
    raise StorageError(
        f"{host} does not give the file: it answered {answer.status_code} {answer.reason}.",
        remedy="Run the command again, which gets a new address.",
    )


def _name(answer: "requests.Response", url: str, otherwise: str) -> str:
    header = answer.headers.get("Content-Disposition", "")
    given = re.search(r"filename\*?=(?:UTF-8'')?\"?([^\";]+)", header, re.IGNORECASE)
    names = [given[1] if given else "", urlsplit(url).path]
    for text in map(unquote, names):
        name = PurePosixPath(text.replace("\\", "/")).name.strip()
        if name and name.isprintable() and not name.startswith("."):
            return name
    return otherwise


def _write(answer: "requests.Response", file: Path, watch: Callable[[int], None]) -> None:
    """Beside the file, then renamed."""
    scratch = ""
    try:
        number, scratch = tempfile.mkstemp(prefix=f".{file.name}-", dir=file.parent)
        with os.fdopen(number, "wb") as out:
            for piece in answer.iter_content(_PIECE_BYTES):
                out.write(piece)
                watch(len(piece))
        hand_out(Path(scratch))
        Path(scratch).replace(file)
    except BaseException as e:
        if scratch:
            with suppress(OSError):
                Path(scratch).unlink()
        if isinstance(e, OSError) and not type(e).__module__.startswith("requests"):
            raise SettingsError(
                f"{file} cannot be written ({e.strerror or e}).",
                remedy="Give another place with -o, or make room.",
            ) from e
        raise


# Deletes a model at DeepRacer on AWS.


@dataclass(frozen=True)
class DeletedModel:
    """The result of `droa-delete-model`."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    model_id: Annotated[str, "Id of the model."]
    name: Annotated[str, "Its name."]
    status: Annotated[str, "DELETING; the server goes on by itself."] = "DELETING"

    def __str__(self) -> str:
        return f"{self.site} is deleting {self.name} ({self.model_id})."


def refuse_undeletable(model: RemoteModel) -> None:
    if model.status not in DELETABLE:
        raise SettingsError(
            f"The model {model.name} ({model.model_id}) has the status "
            f"{model.status or 'unknown'}; only {' and '.join(DELETABLE)} can be deleted.",
            remedy=f"Wait until `droa-get-model {model.model_id}` shows one of them.",
        )


def delete_model(droa: Droa, model: RemoteModel) -> DeletedModel:
    """Begin to delete a model.

    Raises:
        SettingsError: Its status is neither READY nor ERROR.
        StorageError: The call failed.
    """
    refuse_undeletable(model)
    droa.delete(model.model_id)
    return DeletedModel(droa.place, model.model_id, model.name)
