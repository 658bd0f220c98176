"""Reads models once for all pages."""

import math
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, ValidationInfo
from starlette.requests import Request

from drcli.base.errors import SettingsError, shown
from drcli.bucket.bucket import Bucket, Listing
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.model_list import ModelList, ModelListReader, Signature, signature_of
from drcli.model.traces import models_in
from drcli.records.training_record import TrainingRecord
from drcli.transfer.training_list import KnownTrainings, known_trainings
from drcli.transfer.transfer_buckets import bucket_to_look_at
from drcli.web.answers import BadRequest
from drcli.web.served_folder import ServedFolder

NEW_S, OLD_S = 0.8, 15.0
"""Younger lists are not read again, older ones always."""

LIST_SHARE = 30.0
"""Between them: times as long as reading took."""

KNOWN_SHARE = 100.0
MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
METRICS = "DR_LOCAL_S3_METRICS_PREFIX"
PRETRAINED = "DR_LOCAL_S3_PRETRAINED"
DESCRIPTION = "DR_MODEL_DESCRIPTION"


class ModelReader:
    """Shared."""

    def __init__(self, folder: ServedFolder) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._reader = ModelListReader()
        self._bucket_name = ""
        self._list: ModelList | None = None
        self._list_s, self._fresh_s = -math.inf, NEW_S
        self._known: KnownTrainings | None = None
        self._known_of: Signature | None = None
        self._known_s, self._known_took_s = -math.inf, 0.0

    def bucket(self, settings: Settings) -> Bucket:
        return bucket_to_look_at(settings.transfer, upload=False)

    def models(self) -> tuple[ModelList, KnownTrainings]:
        """At most a moment old."""
        with self._lock:
            settings = self.folder.settings()
            bucket = self.bucket(settings)
            began_s = time.monotonic()
            fresh = began_s - self._list_s < self._fresh_s and bucket.name == self._bucket_name
            if self._list is None or self._known is None or not fresh:
                if bucket.name != self._bucket_name:
                    self._reader, self._known, self._bucket_name = (
                        ModelListReader(),
                        None,
                        bucket.name,
                    )
                listed = bucket.list("")
                self._list = self._reader.read(bucket, listed=listed)
                self._read_known(bucket, listed)
                self._list_s = time.monotonic()
                took_s = self._list_s - began_s
                self._fresh_s = min(max(NEW_S, LIST_SHARE * took_s), OLD_S)
            assert self._known is not None
            return self._list, self._known

    def known(self) -> KnownTrainings:
        return self.models()[1]

    def _read_known(self, bucket: Bucket, listed: Listing) -> None:
        # What processes do at the moment is below runs/, and changes every second.
        about = [info for info in listed if not info.key.startswith(("rollouts/", "runs/"))]
        signature = signature_of(about)
        now = time.monotonic()
        if self._known is not None and (
            signature == self._known_of or now - self._known_s < KNOWN_SHARE * self._known_took_s
        ):
            return
        self._known = known_trainings(bucket)
        self._known_of, self._known_s = signature, time.monotonic()
        self._known_took_s = self._known_s - now

    def settings_of(self, prefix: str, flags: Mapping[str, str] | None = None) -> Settings:
        """The settings for a model, which need not be that of run.env.

        `flags` count as options of a command.
        """
        return settings_for(self.folder.directory, prefix, flags)

    def open(self, prefix: str) -> tuple[Settings, Bucket]:
        """BadRequest if the model does not exist."""
        settings = self.folder.settings()
        bucket = self.bucket(settings)
        if prefix not in models_in(bucket.list(keys.folder(prefix))):
            raise BadRequest(f"There is no model {prefix:.200} in s3://{bucket.name}.", 404)
        return settings, bucket

    def record(self, prefix: str) -> TrainingRecord | None:
        try:
            return self.known().find(prefix)
        except SettingsError:
            return None


def settings_for(directory: Path, prefix: str, flags: Mapping[str, str] | None = None) -> Settings:
    """Like `ModelReader.settings_of`."""
    plain = load_settings(directory)
    changed = dict(flags or {})
    if prefix != plain.model_prefix:
        # Weights and description in run.env are for its own model, which may come from this one.
        metrics = keys.metrics_prefix(prefix)
        own = {MODEL: prefix, METRICS: metrics, PRETRAINED: "False", DESCRIPTION: ""}
        changed = {**own, **changed}
    return load_settings(directory, flags=changed) if changed else plain


def prefix_of(request: Request) -> str:
    """From `?prefix=`."""
    return checked(request.query_params.get("prefix"))


def checked(prefix: object, key: str = "") -> str:
    """A name for a model; else BadRequest about `key`."""
    if not isinstance(prefix, str) or not keys.is_valid_prefix(prefix) or len(prefix) > 500:
        raise BadRequest(
            f"“{shown(str(prefix))}” is not the name of a model.",
            remedy="Use letters, digits and . _ - and / between folders.",
            key=key,
        )
    return prefix


def _of_a_field(prefix: object, info: ValidationInfo) -> str:
    return checked(prefix, info.field_name or "")


Prefix = Annotated[str, BeforeValidator(_of_a_field)]
