"""Models at DeepRacer on AWS, as its interface shows them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from drcli.base.errors import SettingsError, StorageError

AssetType = Literal[
    "TRAINING_LOGS", "EVALUATION_LOGS", "PHYSICAL_CAR_MODEL", "VIRTUAL_MODEL", "VIDEOS"
]

DELETABLE = ("READY", "ERROR")
"""The only statuses in which a model can be deleted."""


class NoSuchModel(SettingsError):
    """The account has no model of that id or name."""


@dataclass(frozen=True)
class RemoteModel:
    """A model in the account.

    Attributes:
        model_id: Its id, 15 letters and digits.
        name: Its name; several models can have the same.
        status: Such as READY, ERROR, IMPORTING or TRAINING.
        training_status: Such as COMPLETED; empty if the server gives none.
        created_at: ISO 8601; empty if the server gives none.
        values: Everything that the server says about it, with the keys of its interface.
    """

    model_id: str
    name: str
    status: str
    training_status: str
    created_at: str
    values: Mapping[str, Any]

    def text(self, *path: str) -> str:
        """A value inside `values` as text; empty if there is none."""
        value: Any = self.values
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        return "" if value is None or isinstance(value, dict | list) else str(value)

    @property
    def import_error(self) -> str:
        """Why its import failed; empty if it did not."""
        return self.text("importErrorMessage")


@dataclass(frozen=True)
class Asset:
    """A file to download, or the status of the work that makes it."""

    url: str
    status: str


def read_model(value: Any, place: str) -> RemoteModel:
    """A model as the interface shows it.

    Raises:
        StorageError: It has no id.
    """
    if not isinstance(value, dict) or not isinstance(value.get("modelId"), str):
        raise StorageError(
            f"{place} lists a model without an id.",
            remedy="Try again later; if it fails again, ask who runs that site.",
        )

    def text(key: str) -> str:
        return "" if value.get(key) is None else str(value[key])

    return RemoteModel(
        model_id=value["modelId"],
        name=text("name"),
        status=text("status"),
        training_status=text("trainingStatus"),
        created_at=text("createdAt"),
        values=value,
    )
