"""Deletes a model at DeepRacer on AWS."""

from dataclasses import dataclass

from drcli.base.errors import SettingsError
from drcli.remote.droa_api import Droa
from drcli.remote.droa_models import DELETABLE, RemoteModel


@dataclass(frozen=True)
class DeletedModel:
    """The result of `droa-delete-model`.

    Attributes:
        site: Address of DeepRacer on AWS.
        model_id: Id of the model.
        name: Its name.
        status: DELETING; the server goes on by itself.
    """

    site: str
    model_id: str
    name: str
    status: str = "DELETING"


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
