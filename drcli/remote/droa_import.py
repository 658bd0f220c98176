"""Imports a model into DeepRacer on AWS."""

import hashlib
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from drcli.base import notices
from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.problems import ProblemsError, of_severity
from drcli.remote.droa_api import Droa
from drcli.remote.droa_models import RemoteModel
from drcli.remote.droa_package import is_wanted
from drcli.remote.droa_rules import check_description, check_name, package_problems
from drcli.remote.droa_upload import Watch, remove_files, upload_files
from drcli.remote.web_request import polls

POLL_S = 5.0
IMPORT_PATIENCE_S = 1800.0
"""The server's check may take 15 minutes."""

Progress = Callable[[str, int], AbstractContextManager[Watch]]
Waiting = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class ImportPlan:
    """Passed the checks."""

    name: str
    description: str
    files: Mapping[str, bytes]


@dataclass(frozen=True)
class ImportReport:
    """The result of `droa-import-model`.

    Attributes:
        site: Address of DeepRacer on AWS.
        model_id: Id of the new model; empty after -d.
        name: Its name.
        status: READY, or IMPORTING if nobody waited; empty after -d.
        files: How many files were uploaded.
        uploaded_bytes: Their size.
        folder: Where they are in the upload bucket; empty after -d.
        dry_run: Whether -d was given, so that nothing was sent.
        existed: Whether the same import was there already, so that nothing was sent (--once).
    """

    site: str
    model_id: str
    name: str
    status: str
    files: int
    uploaded_bytes: int
    folder: str
    dry_run: bool = False
    existed: bool = False


class ImportFailed(SettingsError):
    """DeepRacer on AWS has refused the model."""


def plan_import(
    files: Mapping[str, bytes], name: str, description: str = "", *, unchecked: bool = False
) -> ImportPlan:
    """Check a model before anything is sent, and show warnings.

    `unchecked` makes errors in files warnings.

    Raises:
        SettingsError: DeepRacer on AWS would refuse it.
    """
    check_name(name)
    check_description(description)
    wanted = {each: data for each, data in files.items() if is_wanted(each)}
    found = package_problems(wanted)
    for each in of_severity(found, "warning"):
        notices.warn(str(each))
    errors = of_severity(found, "error")
    if errors and not unchecked:
        raise ProblemsError(errors)
    for each in errors:
        notices.warn(f"{each} This does not keep it from being imported, because of --unchecked.")
    return ImportPlan(name, description, wanted)


def planned_report(site: str, plan: ImportPlan) -> ImportReport:
    size = sum(map(len, plan.files.values()))
    return ImportReport(site, "", plan.name, "", len(plan.files), size, "", dry_run=True)


def fingerprint_of(files: Mapping[str, bytes]) -> str:
    whole = hashlib.sha256()
    for name in sorted(files):
        if ".ckpt" in name or name.endswith(".pb"):
            whole.update(f"{name}\0{len(files[name])}\0".encode())
            whole.update(files[name])
    return whole.hexdigest()[:16]


def find_import(droa: Droa, plan: ImportPlan) -> ImportReport | None:
    """An earlier one with the same name and description."""
    for listed in droa.models():
        if listed.name != plan.name or listed.status in ("ERROR", "DELETING"):
            continue
        model = droa.model(listed.model_id)
        if model.text("description") == plan.description:
            return ImportReport(
                droa.place, model.model_id, plan.name, model.status, 0, 0, "", existed=True
            )
    return None


def import_files(
    droa: Droa,
    plan: ImportPlan,
    *,
    progress: Progress,
    waiting: Waiting | None = None,
) -> ImportReport:
    """Import a model; `waiting` None: do not wait.

    Raises:
        ImportFailed: The server refused it.
        StorageError: It failed, or took too long.
    """
    size = sum(map(len, plan.files.values()))
    with progress("Uploading model", size) as watch:
        folder = upload_files(droa.session, plan.files, watch)
    try:
        model_id = droa.import_model(folder, plan.name, plan.description)
    except DrError:
        remove_files(droa.session, folder, list(plan.files))
        raise
    report = ImportReport(
        droa.place, model_id, plan.name, "IMPORTING", len(plan.files), size, folder
    )
    if waiting is None:
        return report
    with waiting(f"{droa.place} checks the model {model_id} ..."):
        model = wait_for_import(droa, model_id)
    return replace(report, status=model.status)


def wait_for_import(droa: Droa, model_id: str) -> RemoteModel:
    """Wait until a model is imported.

    Raises:
        ImportFailed: The server refused it.
        StorageError: A call failed, or it took too long.
    """
    later = f"Ask again with `droa-get-model {model_id}`."
    for _ in polls(POLL_S, IMPORT_PATIENCE_S, droa.pause):
        model = droa.model(model_id)
        if model.status == "READY":
            return model
        if model.status == "ERROR":
            reason = " ".join((model.import_error or "no reason given").split()).rstrip(".")
            raise ImportFailed(
                f"{droa.place} refused the model {model.name} ({model_id}): {reason}.",
                remedy=f"Correct the model and import it again; `droa-delete-model {model_id}` "
                "removes this one.",
            )
        if model.status == "DELETING":
            raise StorageError(
                f"The model {model.name} ({model_id}) is being deleted while it is imported.",
                remedy="Import it again.",
            )
    raise StorageError(
        f"{droa.place} is still busy with the model {model_id} after "
        f"{IMPORT_PATIENCE_S / 60:g} minutes.",
        remedy=later,
    )
