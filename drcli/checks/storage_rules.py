"""The bucket against the rules: does it work, is the model's place free, is the old model there?"""

import time
from dataclasses import dataclass

from drcli.base.errors import SettingsError, StorageError
from drcli.base.problems import FindingsError
from drcli.checks.check_report import Violation
from drcli.checks.translation import from_error, from_findings, from_sentence
from drcli.config.run_config import PretrainedConfig
from drcli.modelfiles.network_shape import Design, refuse_misfit
from drcli.models import pretrained
from drcli.models.pretrained import Transfer
from drcli.store import lease
from drcli.store.bucket import Bucket
from drcli.store.model_prefix import is_used, newest_checkpoint

LARGEST_SKEW_S = 300.0
"""Servers refuse requests that are signed a quarter of an hour off; a third of that is told."""

PROBE_FOLDER = ".validate/"


@dataclass(frozen=True)
class TransferReview:
    """What can be said about the model to start from.

    Attributes:
        transfer: Its weights, None where they cannot be used.
        violations: What is wrong with it.
    """

    transfer: Transfer | None
    violations: list[Violation]


def review_prefix(prefix: str, bucket: Bucket) -> list[Violation]:
    """V-09: nothing may lie where the new model goes."""
    if not is_used(bucket, prefix):
        return []
    model = f"s3://{bucket.name}/{prefix}"
    learned = newest_checkpoint(bucket, prefix) is not None
    go_on = "Continue that training with --resume, replace it" if learned else "Replace it"
    return [
        Violation(
            "V-09",
            "error",
            model,
            f"Selected path {model} exists. Delete it, or use -w option. Exiting.",
            f"{go_on} with -w, or choose another DR_LOCAL_S3_MODEL_PREFIX in run.env.",
        )
    ]


def review_rivals(prefix: str, bucket: Bucket) -> list[Violation]:
    """V-13: whether somebody trains on the model's place already."""
    try:
        lease.refuse_other_owner(bucket, prefix)
    except SettingsError as error:
        where = f"s3://{bucket.name}/{prefix}"
        return [Violation("V-13", "warning", where, str(error), error.remedy)]
    return []


def review_pretrained(
    config: PretrainedConfig, bucket: Bucket, new: str, design: Design | None, *, wiping: bool
) -> TransferReview:
    """V-10 and V-35: the model to start from is there, whole, and fits.

    Args:
        config: Names it.
        bucket: Holds it.
        new: Prefix of the new model.
        design: Of the new model; without one there is nothing that it could fit.
        wiping: Whether what lies under the new model's prefix is going to be deleted.
    """
    try:
        if design is None:
            pretrained.read_weights(bucket, config.prefix, config.checkpoint, config.written)
            return TransferReview(None, [])
        transfer = pretrained.find(config, bucket, new, design, wiping=wiping)
    except SettingsError as error:
        rule = "V-35" if isinstance(error, FindingsError) else "V-10"
        return TransferReview(None, from_error(error, lambda _: rule))
    return TransferReview(transfer, _notes(transfer.warnings))


def review_fit(trained: Design, wanted: Design, model: str) -> list[Violation]:
    """V-35: weights of one design fit another."""
    try:
        return _notes(refuse_misfit(trained, wanted, model))
    except SettingsError as error:
        return from_error(error, lambda _: "V-35")


def _notes(sentences: list[str]) -> list[Violation]:
    notes = [from_sentence(text, "Go on if that is meant.") for text in sentences]
    return from_findings(
        notes, lambda note: "V-35" if "action_space" in note.what else "V-10", "warning"
    )


def probe(bucket: Bucket) -> list[Violation]:
    """V-50: objects can be written, read, listed and deleted, and the clocks agree."""
    key, content = f"{PROBE_FOLDER}{time.time_ns()}", b"probe"
    try:
        bucket.put(key, content)
        came_back = bucket.get(key) == content
        written = [item for item in bucket.list(PROBE_FOLDER) if item.key == key]
        bucket.delete([key])
        gone = not bucket.exists(key)
    except StorageError as error:
        return [Violation("V-50", "error", bucket.name, str(error), error.remedy)]
    if not (came_back and written and gone):
        return [
            Violation(
                "V-50",
                "error",
                bucket.name,
                "The bucket does not give back, list or delete what was written to it.",
                "Use another S3 server; this one would lose a model.",
            )
        ]
    skew_s = time.time() - written[0].modified.timestamp()
    if abs(skew_s) > LARGEST_SKEW_S:
        return [
            Violation(
                "V-50",
                "warning",
                bucket.name,
                f"The clock of this machine is {abs(skew_s) / 60:.0f} minutes "
                f"{'ahead of' if skew_s > 0 else 'behind'} the server's.",
                "Set it right, as with `sudo timedatectl set-ntp true`; servers refuse requests "
                "that are signed 15 minutes off.",
            )
        ]
    return []
