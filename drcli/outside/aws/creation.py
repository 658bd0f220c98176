"""Starts a training at Amazon, after all checks."""

import json
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from shlex import quote
from typing import Annotated, Any, Literal

from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.report import View, minute
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.s3_errors import error_code
from drcli.config.settings import Settings
from drcli.model import keys, lease
from drcli.model.model_prefix import (
    ModelListing,
    is_aborted_start,
    newest_checkpoint,
    what_helps,
)
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome, write_outcome
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.instance_types import (
    InstanceType,
    Processor,
    check_quotas,
    default_types,
    find_images,
    find_network,
    find_types,
)
from drcli.outside.aws.machine_marks import file_key, install_key, stack_folder
from drcli.outside.aws.prices import current_prices, on_demand_prices
from drcli.outside.aws.racer_files import InstallSource, torch_requirement
from drcli.outside.aws.stacks import (
    BUCKET_TAG,
    ENDS_TAG,
    Pause,
    create_stack,
    refuse_existing,
    subscribe,
)
from drcli.outside.aws.training_template import (
    KIND_TAG,
    MODEL_TAG,
    STACK_TAG,
    Group,
    Places,
    run_folders,
    training_template,
)
from drcli.transfer.transfer_buckets import refuse_overlap

with lazy_imports():
    from botocore import exceptions as boto

# What is asked for, and its checks that need no machine.


Market = Literal["spot", "spot-or-on-demand", "on-demand"]
_KINDS = {
    "spot": "a spot machine",
    "spot-or-on-demand": "a spot machine, or an ordinary one while there is none",
    "on-demand": "an ordinary machine",
}

LEAST_MINUTES, MOST_MINUTES = 15, 10_080
"""At most a week, as groups may be forgotten."""


@dataclass(frozen=True)
class StackOptions:
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


def check_options(options: StackOptions) -> None:
    """Check what needs no question to Amazon.

    Raises:
        SettingsError: An option is impossible.
    """
    minutes = options.ttl_minutes
    if minutes and not LEAST_MINUTES <= minutes <= MOST_MINUTES:
        raise SettingsError(
            f"{minutes} minutes cannot be the time of a stack.",
            remedy=f"Choose {LEAST_MINUTES} to {MOST_MINUTES} minutes; 0 means no limit.",
        )
    if options.most_usd is not None and not options.most_usd > 0:
        raise SettingsError(
            f"{options.most_usd} USD cannot be the highest price per hour.",
            remedy="Choose a price above 0, or leave --max-price out.",
        )


def check_bucket(account: Account, name: str) -> S3Bucket:
    """The bucket of the models.

    Raises:
        DrError: It is unusable or in another region.
    """
    with account.trying(f"open the bucket {name}"):
        try:
            answer = account.client("s3").head_bucket(Bucket=name)
        except boto.ClientError as error:
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


def model_state(bucket: S3Bucket, prefix: str, parameter_file: str) -> tuple[str, list[str]]:
    """Checkpoint to go on from, and notes.

    Raises:
        SettingsError: Another machine trains the model, or the prefix holds something else.
    """
    store = ModelStore(bucket, prefix)
    lease.refuse_other_owner(store)
    newest = newest_checkpoint(store)
    model = f"s3://{bucket.name}/{prefix}"
    listed = ModelListing(store)
    if newest is None and not listed.objects:
        return "", []
    notes = []
    if newest is None and is_aborted_start(listed, [parameter_file]):
        notes.append(f"A training of {model} ended before its first checkpoint; it begins anew.")
    elif newest is None:
        raise SettingsError(
            f"{model} holds objects, but no checkpoint to resume from.",
            remedy=what_helps(
                store,
                setting="DR_LOCAL_S3_MODEL_PREFIX",
                variables=_settings(bucket),
            ),
        )
    if bucket.exists(keys.finished(prefix)):
        notes.append(
            f"The training of {model} has ended at {newest} before; if its goal is still met, the "
            "machine has nothing to do and ends at once."
        )
    outcome = read_outcome(store)
    if newest is not None and outcome is not None and outcome.stays_ended:
        notes.append(f"The training of {model} was stopped before; it is continued now.")
    return str(newest or ""), notes


def _settings(bucket: S3Bucket) -> str:
    values = {
        "DR_CLOUD": "aws",
        "DR_LOCAL_S3_BUCKET": bucket.name,
        "DR_LOCAL_S3_PROFILE": bucket.endpoint.profile or "default",
        "DR_AWS_APP_REGION": bucket.endpoint.region,
    }
    return "".join(f"{name}={quote(value)} " for name, value in values.items())


def continue_stopped(bucket: S3Bucket, prefix: str) -> None:
    model = ModelStore(bucket, prefix)
    outcome = read_outcome(model)
    if outcome is not None and outcome.stays_ended:
        write_outcome(model, replace(outcome, stays_ended=False))


def key_of(account: Account, bucket: str) -> str:
    """Empty for Amazon's own KMS key, or if unknown."""
    rules: list[Any] = []
    # Old buckets have none, and not everybody may ask.
    with account.trying(f"look at the encryption of {bucket}"), suppress(boto.ClientError):
        answer = account.client("s3").get_bucket_encryption(Bucket=bucket)
        rules = answer["ServerSideEncryptionConfiguration"]["Rules"]
    for rule in rules:
        key = str(rule.get("ApplyServerSideEncryptionByDefault", {}).get("KMSMasterKeyID", ""))
        if key:
            start = f"arn:aws:kms:{account.region}:{account.number}:key/"
            return key if key.startswith("arn:") else start + key
    return ""


# Cost of machines before there are any.


DISK_USD_PER_GB_HOUR = 0.08 / 730
ADDRESS_USD_PER_HOUR = 0.005
"""gp3 disk and public IPv4 address in Virginia, 2026."""


@dataclass(frozen=True)
class Estimate:
    """USD per hour.

    Attributes:
        least: Cheapest machine now; None if unknown.
        most: Dearest machine that may be used.
        extra: Disk and address.
        hours: Longest life; None for ever.
    """

    least: float | None
    most: float | None
    extra: float
    hours: float | None

    @property
    def total(self) -> float | None:
        if self.most is None or self.hours is None:
            return None
        return (self.most + self.extra) * self.hours


def known_prices(
    account: Account, types: Sequence[InstanceType], market: str
) -> tuple[list[float], dict[str, float], list[str]]:
    """Hourly prices that may be paid, on-demand prices, and notes."""
    names, notes = [each.name for each in types], []
    spot: list[float] = []
    ordinary: dict[str, float] = {}
    if market != "on-demand":
        try:
            spot = list(current_prices(account, names).values())
        except DrError as error:
            notes.append(f"{error} The estimate is incomplete.")
    if market != "spot":
        try:
            ordinary = on_demand_prices(account, names)
        except DrError as error:
            notes.append(f"{error} The estimate is incomplete.")
    return [*spot, *ordinary.values()], ordinary, notes


def estimate(prices: list[float], options: StackOptions) -> Estimate:
    """Raises StorageError if no machine is as cheap as wanted."""
    cap = options.most_usd
    if cap is not None and options.market == "spot":
        prices = [price for price in prices if price <= cap]
        if not prices:
            raise StorageError(
                f"No spot machine costs at most {cap} USD per hour now.",
                remedy="Raise --max-price, or allow other types; `dr-spot prices` shows them.",
            )
    return Estimate(
        min(prices, default=None),
        max(prices, default=None),
        options.disk_gb * DISK_USD_PER_GB_HOUR + ADDRESS_USD_PER_HOUR,
        options.ttl_minutes / 60 if options.ttl_minutes else None,
    )


MOST_TEMPLATE_BYTES = 51_200


@dataclass(frozen=True)
class StackPlan:
    """A training that can be started.

    Attributes:
        resumes: Checkpoint; empty for a new model.
        ends: Unix seconds; 0 for never.
        install: What the machine reads first.
        not_imported: Why the model is not imported although that is asked for; empty if not.
    """

    options: StackOptions
    settings: Settings
    source: InstallSource
    types: tuple[InstanceType, ...]
    zones: tuple[str, ...]
    estimate: Estimate
    resumes: str
    ends: float
    notes: tuple[str, ...]
    template: Any
    install: Mapping[str, Any]
    files: Mapping[str, bytes]
    not_imported: str


@dataclass(frozen=True)
class _NewStack:
    stack: Annotated[str, "Name of the stack."]
    region: Annotated[str, "AWS region."]
    bucket: Annotated[str, "Name of the bucket."]
    model: Annotated[str, "Prefix of the model in the bucket."]
    types: Annotated[tuple[str, ...], "Types that may be used."]
    market: Annotated[Market, "`spot`, `on-demand` or `spot-or-on-demand`."]


@dataclass(frozen=True)
class CreatedStack(_NewStack):
    """What was started."""

    usd_per_hour: Annotated[float | None, "Cheapest machine now; None if unknown."]
    most_usd: Annotated[float | None, "Highest cost until the end; None if unknown or unlimited."]
    ends: Annotated[float, "When its machines end, in Unix seconds; 0 for never."]
    topic: Annotated[str, "ARN of the topic for messages."]

    def __str__(self) -> str:
        until = f" It ends at {minute(self.ends)} at the latest." if self.ends else ""
        model = f"s3://{self.bucket}/{self.model}"
        return f"Started {self.stack} in {self.region}: trains {model}.{until}"


@dataclass(frozen=True)
class Planned(_NewStack):
    """A plan for programs."""

    resumes: Annotated[
        str, "The checkpoint from which the training continues; empty for a new model."
    ]
    zones: Annotated[tuple[str, ...], "Zones that may be used."]
    ttl_minutes: Annotated[int, "Time after which the machines end; 0 for never."]
    least_usd_per_hour: Annotated[
        float | None, "Price of the cheapest machine now; None if unknown."
    ]
    most_usd_per_hour: Annotated[
        float | None, "Price of the dearest machine that may be used; None if unknown."
    ]
    extra_usd_per_hour: Annotated[float, "Price of disk and address."]
    most_usd: Annotated[
        float | None, "Highest cost until the end; None if unknown or without a time limit."
    ]
    installs: Annotated[str, "What the machine installs."]
    files: Annotated[tuple[str, ...], "Names of the files that the machine gets."]
    uploads_to: Annotated[
        str, "Where the best model is after every end and interruption, an s3:// address."
    ]
    not_imported: Annotated[
        str, "Why it is not imported into DeepRacer on AWS although the settings ask for it."
    ]

    @staticmethod
    def of(plan: StackPlan, region: str) -> "Planned":
        """The plan."""
        options, money = plan.options, plan.estimate
        return Planned(
            options.stack,
            region,
            options.bucket,
            plan.settings.model_prefix,
            tuple(each.name for each in plan.types),
            options.market,
            plan.resumes,
            plan.zones,
            options.ttl_minutes,
            money.least,
            money.most,
            money.extra,
            money.total,
            plan.source.shown,
            tuple(sorted(plan.files)),
            f"s3://{plan.settings.upload_s3_bucket}/{plan.settings.upload_s3_prefix}",
            plan.not_imported,
        )

    def view(self) -> View:
        goes_on = f", from {self.resumes}" if self.resumes else ""
        model = f"s3://{self.bucket}/{self.model}{goes_on}"
        least, most = self.least_usd_per_hour, self.most_usd_per_hour
        price = "What it costs is not known."
        if least is not None and most is not None:
            to = f" to {most:.3f}" if most - least >= 0.0005 else ""
            rest = f"{self.extra_usd_per_hour:.3f} for the rest"
            price = f"Price now: {least:.3f}{to} USD per hour, and {rest}."
        end = "It runs, and costs money, until the training ends: there is no time limit."
        if self.ttl_minutes:
            known = self.most_usd is not None
            hours = f"{self.ttl_minutes / 60:g} h"
            end = f"At most {self.most_usd:.2f} USD in {hours}, at these prices." if known else ""
        return [
            f"{self.stack}: trains {model} on {_KINDS[self.market]} in {self.region}.",
            f"Types: {', '.join(self.types)}; zones: {', '.join(self.zones)}; "
            f"installs {self.installs}.",
            f"The best model is in {self.uploads_to} after every end and every interruption.",
            self.not_imported
            and "DR_IMPORT_MODEL_ON_COMPLETION asks for an import into DeepRacer on AWS, which the "
            f"machine does not do: {self.not_imported}",
            price,
            end,
        ]


def prepare(
    account: Account,
    settings: Settings,
    options: StackOptions,
    source: InstallSource,
    files: Mapping[str, bytes],
    variables: Mapping[str, str],
    not_imported: str = "",
) -> StackPlan:
    """Check everything, and estimate the cost; changes nothing.

    `files` and `variables` are what the machine gets; `not_imported` as in the plan.

    Raises:
        DrError: The training cannot start.
    """
    check_options(options)
    refuse_existing(account, options.stack)
    bucket = check_bucket(account, options.bucket)
    resumes, notes = model_state(bucket, settings.model_prefix, settings.training_params_file)
    place = account.bucket(settings.upload_s3_bucket)
    refuse_overlap(
        (bucket, settings.model_prefix),
        (place, settings.upload_s3_prefix),
        flag="DR_UPLOAD_S3_PREFIX",
        may_write=False,
    )
    named = bool(options.types)
    names = options.types or default_types(options.processor)
    network = find_network(account, options.subnets)
    types = find_types(account, names, named=named)
    types, left_out = check_quotas(account, types, spot=options.market != "on-demand")
    notes += left_out
    if options.market == "spot-or-on-demand":
        notes += check_quotas(account, types, spot=False)[1]
    graphics = [each.name for each in types if each.graphics]
    if graphics:
        notes.append(
            f"{', '.join(graphics)} costs more for a graphics card that drcli does not use there."
        )
    prices, ordinary, unknown = known_prices(account, types, options.market)
    notes += unknown
    images = find_images(account, [each.architecture for each in types], options.image)
    now = time.time()
    ends = float(int(now + 60 * options.ttl_minutes)) if options.ttl_minutes else 0.0
    group = Group(
        types={each.name: each.architecture for each in types},
        images=images,
        subnets=network.subnets,
        network=network.id,
        market=options.market,
        most_usd=options.most_usd,
        ends=ends,
        disk_gb=options.disk_gb,
        key_name=options.key_name,
    )
    places = _places(account, settings, options)
    template = training_template(options.stack, settings.model_prefix, group, places, options.topic)
    if len(json.dumps(template)) > MOST_TEMPLATE_BYTES:
        raise SettingsError(
            f"{len(types)} types make a template that is too large for CloudFormation.",
            remedy="Name fewer types with --type.",
        )
    return StackPlan(
        options,
        settings,
        source,
        tuple(types),
        network.zones,
        estimate(prices, options),
        resumes,
        ends,
        tuple(notes),
        template,
        _install(settings, source, files, variables, ordinary),
        files,
        not_imported,
    )


def carry_out(account: Account, plan: StackPlan, pause: Pause = time.sleep) -> CreatedStack:
    """Send the files, and make the stack; a failure removes them.

    Raises:
        StorageError: The bucket or Amazon failed.
    """
    options, name = plan.options, plan.options.stack
    bucket = account.bucket(options.bucket)
    try:
        # Files of an earlier stack of this name: its machines and logs are not this one's.
        forget_files(bucket, name)
        for file, data in plan.files.items():
            bucket.put(file_key(name, file), data)
        if plan.source.wheel:
            bucket.put(stack_folder(name) + plan.source.wheel, plan.source.data)
        bucket.put(install_key(name), json.dumps(plan.install).encode())
        continue_stopped(bucket, plan.settings.model_prefix)
        tags = {
            STACK_TAG: name,
            MODEL_TAG: plan.settings.model_prefix[:256],
            KIND_TAG: "training",
            BUCKET_TAG: options.bucket,
            ENDS_TAG: f"{plan.ends:.0f}",
        }
        stack = create_stack(account, name, plan.template, tags, roles=True, pause=pause)
    except BaseException:
        with suppress(DrError):
            forget_files(bucket, name)
        raise
    if options.email:
        subscribe(account, stack.outputs["Topic"], options.email)
    return CreatedStack(
        name,
        account.region,
        options.bucket,
        plan.settings.model_prefix,
        tuple(each.name for each in plan.types),
        options.market,
        plan.estimate.least,
        plan.estimate.total,
        stack.ends,
        stack.outputs["Topic"],
    )


def forget_files(bucket: S3Bucket, stack: str) -> int:
    found = [info.key for info in bucket.list(stack_folder(stack))]
    bucket.delete(found)
    return len(found)


def _places(account: Account, settings: Settings, options: StackOptions) -> Places:
    own_files = {
        key.rpartition("/")[0]
        for key in (settings.reward_key, settings.hyperparameters_key, settings.model_metadata_key)
    }
    folders = {
        *run_folders(settings.model_prefix),
        settings.metrics_prefix,
        settings.custom_files_prefix,
        stack_folder(options.stack).rstrip("/"),
        *(folder for folder in own_files if folder),
    }
    upload = settings.upload_s3_bucket
    elsewhere = upload not in ("not-defined", "", options.bucket)
    if not elsewhere:
        folders.add(settings.upload_s3_prefix)
    reads = (settings.pretrained_prefix,) if settings.pretrained else ()
    return Places(
        options.bucket,
        tuple(sorted(folders)),
        reads,
        upload if elsewhere else "",
        settings.upload_s3_prefix if elsewhere else "",
        key_of(account, options.bucket),
        settings.cloud_watch_log_group if settings.cloud_watch_enable else "",
    )


def _install(
    settings: Settings,
    source: InstallSource,
    files: Mapping[str, bytes],
    variables: Mapping[str, str],
    ordinary: Mapping[str, float],
) -> dict[str, Any]:
    priced = "DR_SPOT_PRICE" in settings.sources or "DR_SPOT_PRICE" in settings.extra
    return {
        "source": source.requirement,
        "wheel": source.wheel,
        "sha256": source.sha256,
        "torch": torch_requirement(),
        "packages": list(source.packages),
        "files": sorted(files),
        "environment": dict(variables),
        "given": ["DR_SPOT_PRICE"] if priced else [],
        "on_demand_usd": dict(ordinary),
        "continues": settings.continue_on_spot_interruption,
        "model": settings.model_prefix,
    }
