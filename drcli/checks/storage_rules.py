"""Checks the bucket: it works, is free, and has the old model."""

import time
import uuid

from drcli.base.errors import SettingsError, StorageError
from drcli.base.problems import Problem, ProblemsError
from drcli.config.bucket_config import PretrainedConfig
from drcli.modelfiles.network_shape import Design
from drcli.models import pretrained
from drcli.models.pretrained import Transfer
from drcli.store import keys, lease
from drcli.store.bucket import TEST_FOLDER, Bucket
from drcli.store.lost_checkpoints import find_lost
from drcli.store.model_kind import KIND_WORDS, model_kind
from drcli.store.model_prefix import is_used
from drcli.store.s3_errors import AccessRefused

LARGEST_SKEW_S = 300.0
"""Servers refuse requests from 15 minutes on."""


def review_prefix(prefix: str, bucket: Bucket) -> list[Problem]:
    """V-09: the prefix of the new model is empty."""
    if not is_used(bucket, prefix):
        return []
    model = f"s3://{bucket.name}/{prefix}"
    kind = model_kind(bucket, prefix)
    lost = find_lost(bucket, prefix)
    if lost is not None:
        refusal = lost.refusal()
        return [Problem("V-09", "error", model, None, str(refusal), refusal.remedy)]
    what = f"Selected path {model} exists. It holds {KIND_WORDS[kind]}. Exiting."
    remedy = "Choose another DR_LOCAL_S3_MODEL_PREFIX in run.env; -w would delete what is there."
    if kind in ("drcli", "tensorflow"):
        remedy = f"Continue that training with `dr-start-training --resume`. {remedy}"
    return [Problem("V-09", "error", model, None, what, remedy)]


def review_owner(prefix: str, bucket: Bucket) -> list[Problem]:
    """V-13: no other run trains this model."""
    try:
        lease.refuse_other_owner(bucket, prefix)
    except SettingsError as error:
        model = f"s3://{bucket.name}/{prefix}"
        return [Problem("V-13", "error", model, None, str(error), error.remedy)]
    return []


def review_pretrained(
    config: PretrainedConfig, bucket: Bucket, new: str, design: Design | None, *, wiping: bool
) -> tuple[Transfer | None, list[Problem]]:
    """V-10 and V-35: the model to start from exists, is complete, and fits."""
    try:
        if design is None:
            pretrained.named_weights(config, bucket)
            return None, []
        transfer = pretrained.find(config, bucket, new, design, wiping=wiping)
    except ProblemsError as error:
        return None, list(error.problems)
    return transfer, transfer.warnings


def probe(bucket: Bucket, prefix: str) -> list[Problem]:
    """V-50: objects can be written, read, listed and deleted; returns a warning about the clock.

    Tried among the model's records: keys may be limited to its folders.

    Raises:
        StorageError: They cannot.
    """
    folder = f"{keys.run_folder(prefix)}{TEST_FOLDER}-{uuid.uuid4().hex}/"
    key, content = f"{folder}object", b"probe"
    try:
        bucket.put(key, content)
        try:
            came_back = bucket.get(key) == content
            written = [item for item in bucket.list(folder) if item.key == key]
        finally:
            bucket.delete([key])
    except AccessRefused as error:
        needed = (keys.folder(prefix), keys.run_folder(prefix), keys.rollouts_folder(prefix))
        raise error.below(needed) from error
    if not (came_back and written) or bucket.exists(key):
        raise StorageError(
            f"The bucket {bucket.name} does not correctly return, list or delete objects.",
            remedy="Use another S3 server; this one could lose a model.",
        )
    skew_s = time.time() - written[0].modified.timestamp()
    if abs(skew_s) <= LARGEST_SKEW_S:
        return []
    what = (
        f"The clock of this machine is {abs(skew_s) / 60:.0f} minutes "
        f"{'ahead of' if skew_s > 0 else 'behind'} the server's."
    )
    remedy = (
        "Set the clock, as with `sudo timedatectl set-ntp true`; servers refuse requests if the "
        "clocks differ by 15 minutes."
    )
    return [Problem("V-50", "warning", bucket.name, None, what, remedy)]
