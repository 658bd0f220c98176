"""What is asked for, and its checks that need no machine."""

from dataclasses import dataclass, replace
from shlex import quote
from typing import Literal

from drcli.base.errors import SettingsError
from drcli.spot.aws_account import Account
from drcli.spot.instance_types import Processor
from drcli.store import keys, lease
from drcli.store.last_outcome import read_outcome, write_outcome
from drcli.store.model_kind import what_helps
from drcli.store.model_prefix import is_used, newest_checkpoint
from drcli.store.s3_bucket import S3Bucket
from drcli.store.s3_errors import error_code

Market = Literal["spot", "spot-or-on-demand", "on-demand"]

LEAST_MINUTES, MOST_MINUTES = 15, 10_080
"""At most a week, as groups may be forgotten."""


@dataclass(frozen=True)
class Wishes:
    """What a racer asks for.

    Attributes:
        types: Empty for the default ones.
        ttl_minutes: 0 for ever.
        most_usd: Per hour of a spot machine.
        topic: ARN; empty to make one.
        image: Empty for Ubuntu 24.04.
        subnets: Empty for the default network.
    """

    stack: str
    bucket: str
    types: tuple[str, ...] = ()
    processor: Processor = "x86"
    market: Market = "spot"
    ttl_minutes: int = 720
    most_usd: float | None = None
    disk_gb: int = 30
    topic: str = ""
    email: str = ""
    key_name: str = ""
    image: str = ""
    subnets: tuple[str, ...] = ()


def check_wishes(wishes: Wishes) -> None:
    """Check what needs no question to Amazon.

    Raises:
        SettingsError: A wish is impossible.
    """
    minutes = wishes.ttl_minutes
    if minutes and not LEAST_MINUTES <= minutes <= MOST_MINUTES:
        raise SettingsError(
            f"{minutes} minutes cannot be the time of a stack.",
            remedy=f"Choose {LEAST_MINUTES} to {MOST_MINUTES} minutes; 0 means no limit.",
        )
    if wishes.most_usd is not None and not wishes.most_usd > 0:
        raise SettingsError(
            f"{wishes.most_usd} USD cannot be the highest price per hour.",
            remedy="Choose a price above 0, or leave --max-price out.",
        )


def check_bucket(account: Account, name: str) -> S3Bucket:
    """The bucket of the models.

    Raises:
        DrError: It is unusable or in another region.
    """
    from botocore.exceptions import ClientError

    with account.trying(f"open the bucket {name}"):
        try:
            answer = account.client("s3").head_bucket(Bucket=name)
        except ClientError as error:
            if error_code(error) in ("404", "NoSuchBucket"):
                raise SettingsError(
                    f"There is no bucket {name}.",
                    remedy="Make one with `dr-spot create-base NAME`, or name one with --bucket.",
                ) from error
            if error_code(error) != "301":
                raise
            answer = error.response
    headers = answer["ResponseMetadata"].get("HTTPHeaders", {})
    region = answer.get("BucketRegion") or headers.get("x-amz-bucket-region") or account.region
    if region != account.region:
        raise SettingsError(
            f"The bucket {name} is in {region}, but the machines would be in {account.region}; "
            "every checkpoint would travel between both, which costs time and money.",
            remedy=f"Use --region {region}, or a bucket in {account.region}.",
        )
    return account.bucket(name)


def model_state(bucket: S3Bucket, prefix: str) -> tuple[str, list[str]]:
    """Checkpoint to go on from, and notes.

    Raises:
        SettingsError: Another machine trains the model, or the prefix holds something else.
    """
    lease.refuse_other_owner(bucket, prefix)
    newest = newest_checkpoint(bucket, prefix)
    model = f"s3://{bucket.name}/{prefix}"
    if newest is None:
        if is_used(bucket, prefix):
            raise SettingsError(
                f"{model} holds objects, but no checkpoint to resume from.",
                remedy=what_helps(
                    bucket, prefix, setting="DR_LOCAL_S3_MODEL_PREFIX", variables=_settings(bucket)
                ),
            )
        return "", []
    notes = []
    if bucket.exists(keys.finished(prefix)):
        notes.append(
            f"The training of {model} has ended at {newest} before; if its goal is still met, the "
            "machine has nothing to do and ends at once."
        )
    outcome = read_outcome(bucket, prefix)
    if outcome is not None and outcome.stays_ended:
        notes.append(f"The training of {model} was stopped before; it is continued now.")
    return str(newest), notes


def _settings(bucket: S3Bucket) -> str:
    values = {
        "DR_CLOUD": "aws",
        "DR_LOCAL_S3_BUCKET": bucket.name,
        "DR_LOCAL_S3_PROFILE": bucket.endpoint.profile or "default",
        "DR_AWS_APP_REGION": bucket.endpoint.region,
    }
    return "".join(f"{name}={quote(value)} " for name, value in values.items())


def continue_stopped(bucket: S3Bucket, prefix: str) -> None:
    outcome = read_outcome(bucket, prefix)
    if outcome is not None and outcome.stays_ended:
        write_outcome(bucket, prefix, replace(outcome, stays_ended=False))


def key_of(account: Account, bucket: str) -> str:
    """Empty for Amazon's own KMS key, or if unknown."""
    from botocore.exceptions import ClientError

    with account.trying(f"look at the encryption of {bucket}"):
        try:
            answer = account.client("s3").get_bucket_encryption(Bucket=bucket)
        except ClientError:
            return ""  # old buckets have none, and not everybody may ask
    for rule in answer["ServerSideEncryptionConfiguration"]["Rules"]:
        key = str(rule.get("ApplyServerSideEncryptionByDefault", {}).get("KMSMasterKeyID", ""))
        if key:
            start = f"arn:aws:kms:{account.region}:{account.number}:key/"
            return key if key.startswith("arn:") else start + key
    return ""
