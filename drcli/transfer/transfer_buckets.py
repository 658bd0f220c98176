"""Opens the two buckets of a transfer, and refuses damage."""

import re
import uuid
from dataclasses import replace

from drcli.base.errors import BadValue, SettingsError, shown
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import (
    COMMAND_PATIENCE_S,
    open_bucket,
    open_running_bucket,
    open_upload_bucket,
)
from drcli.bucket.endpoint import UPLOADS, SettingNames
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.config.run_config import TransferConfig
from drcli.config.value_types import upload_bucket
from drcli.model import keys, lease
from drcli.model.model_prefix import contains
from drcli.model.model_store import ModelStore

COPY_PATIENCE_S = 120.0
"""A bad network gets time to recover."""

UNDEFINED = "not-defined"
"""From the reference's template."""

_ADDRESS = SettingNames(bucket="-s", prefix="-s")

_URL = re.compile(r"s3://([A-Za-z0-9][A-Za-z0-9._-]{2,62})/(.+)")


def target_bucket(
    ends: TransferConfig, *, local: bool, patience_s: float, otherwise: str = ""
) -> Bucket:
    """The upload bucket, or our own if `local`; `otherwise` is another remedy.

    Raises:
        SettingsError: There is no upload bucket.
    """
    if local:
        return open_bucket(ends.own, patience_s=patience_s)
    if ends.upload.bucket in ("", UNDEFINED):
        raise SettingsError(
            "No upload bucket defined. Exiting.",
            remedy=f"Set DR_UPLOAD_S3_BUCKET in system.env{f', {otherwise}' if otherwise else ''}.",
        )
    try:
        upload_bucket(ends.upload.bucket)
    except BadValue as bad:
        what = f"DR_UPLOAD_S3_BUCKET={shown(ends.upload.bucket)} {bad.reason}."
        raise SettingsError(what, remedy=bad.remedy) from bad
    return open_upload_bucket(ends.upload, patience_s=patience_s)


def bucket_to_look_at(ends: TransferConfig, *, upload: bool) -> Bucket:
    """Starts our server only if needed to read."""
    if not upload:
        found = open_running_bucket(ends.own)
        if found is not None:
            return found
    return target_bucket(
        ends,
        local=not upload,
        patience_s=COMMAND_PATIENCE_S,
        otherwise="or list the local bucket with `dr-list-models`",
    )


def source_bucket(ends: TransferConfig, name: str, *, local: bool, patience_s: float) -> Bucket:
    """At the server of uploads, or our own if `local`."""
    if local:
        own = server.ensure_running(ends.own)
        return S3Bucket(replace(own, names=_ADDRESS), name, patience_s=patience_s)
    return open_upload_bucket(
        ends.upload,
        name=name,
        names=replace(UPLOADS, bucket="-s", prefix="-s"),
        patience_s=patience_s,
    )


def parse_url(url: str, flag: str = "-s") -> tuple[str, str]:
    """From `s3://bucket/team/model-1`; raises SettingsError."""
    found = _URL.fullmatch(url.strip())
    prefix = found[2].strip("/") if found else ""
    if found is None or not keys.is_valid_prefix(prefix):
        raise SettingsError(
            f"{flag} '{shown(url)}' is not the address of a model.",
            remedy="Write it as s3://bucket/team/model-1.",
        )
    return found[1], prefix


def checked_prefix(prefix: str, flag: str) -> str:
    """Raises SettingsError if it is not valid."""
    plain = prefix.rstrip("/")
    if not keys.is_valid_prefix(plain):
        raise SettingsError(
            f"{flag} '{shown(prefix)}' cannot be the name of a model.",
            remedy="Use letters, digits and . _ - and / between folders, as in team/model-1.",
        )
    return plain


def refuse_overlap(
    source: tuple[Bucket, str], target: tuple[Bucket, str], *, flag: str, may_write: bool
) -> None:
    """Refuse to copy a model onto itself, or into its folder.

    A server can have many addresses: with `may_write`, a short-lived object shows it.

    Raises:
        SettingsError: They overlap.
    """
    before, after = source[1], target[1]
    if not (contains(before, after) or contains(after, before)):
        return
    if not _is_same(source[0], target[0], after, may_write=may_write):
        return
    problem = f"{after} overlaps with {before}; wiping one would delete the other."
    if before == after:
        problem = "Target equals source. Exiting."
    raise SettingsError(problem, remedy=f"Choose another prefix with {flag}.")


def refuse_nesting(store: ModelStore, custom_files: str, *, flag: str) -> None:
    """Refuse to mix a copy in our own bucket with other things.

    Raises:
        SettingsError: It would be in a folder with another model or the racer's files.
    """
    if contains(custom_files, store.prefix) or contains(store.prefix, custom_files):
        raise SettingsError(
            f"{store.prefix} overlaps with {custom_files}, the folder of your own files "
            "(DR_LOCAL_S3_CUSTOM_FILES_PREFIX).",
            remedy=f"Choose another prefix with {flag}.",
        )
    above = [
        "/".join(store.prefix.split("/")[:depth]) for depth in range(1, store.prefix.count("/") + 1)
    ]
    models = [model for model in above if store.bucket.exists(keys.coach_checkpoint(model))]
    index = keys.coach_checkpoint(store.prefix)
    end = index.removeprefix(keys.folder(store.prefix))
    models += [
        info.key.removesuffix(f"/{end}")
        for info in store.bucket.list(keys.folder(store.prefix))
        if info.key.endswith(f"/{end}") and info.key != index
    ]
    if models:
        raise SettingsError(
            f"{store.prefix} overlaps with the model {models[0]}; "
            "wiping one would delete the other.",
            remedy=f"Choose another prefix with {flag}.",
        )


def refuse_training(model: ModelStore) -> None:
    """Raises SettingsError if it is being trained."""
    held = lease.live_holder(model)
    if held is not None:
        raise SettingsError(
            f"{model.url} is being trained by {held.owner}.",
            remedy="Choose another prefix, or stop that training first.",
        )


def _is_same(source: Bucket, target: Bucket, prefix: str, *, may_write: bool) -> bool:
    """The test object is below the prefix, where keys may be limited to."""
    if source is target:
        return True
    if source.name != target.name:
        return False
    if not may_write:
        return getattr(source, "endpoint", None) == getattr(target, "endpoint", 0)
    probe = f"{keys.folder(prefix)}.probe-{uuid.uuid4().hex}.txt"
    target.put(probe, b"probe")
    try:
        return source.exists(probe)
    finally:
        target.delete([probe])
