"""Models at DeepRacer on AWS."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from drcli.base.errors import SettingsError, StorageError

AssetType = Literal[
    "TRAINING_LOGS", "EVALUATION_LOGS", "PHYSICAL_CAR_MODEL", "VIRTUAL_MODEL", "VIDEOS"
]

DELETABLE = ("READY", "ERROR")


class NoSuchModel(SettingsError):
    """The account has none of that id or name."""


@dataclass(frozen=True)
class RemoteModel:
    """A model in the account; several can have the same name."""

    model_id: str
    name: str
    status: str
    training_status: str
    created_at: str
    values: Mapping[str, Any]

    def text(self, *path: str) -> str:
        value: Any = self.values
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        return "" if value is None or isinstance(value, dict | list) else str(value)

    @property
    def import_error(self) -> str:
        return self.text("importErrorMessage")


@dataclass(frozen=True)
class Asset:
    """May be unfinished."""

    url: str
    status: str


def read_model(value: Any, place: str) -> RemoteModel:
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
