"""Starts a training at Amazon, after all checks."""

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from drcli.base.errors import DrError, SettingsError
from drcli.config.settings import Settings
from drcli.spot.aws_account import Account
from drcli.spot.before_spending import (
    Market,
    Wishes,
    check_bucket,
    check_wishes,
    continue_stopped,
    key_of,
    model_state,
)
from drcli.spot.cost_estimate import Estimate, estimate, known_prices
from drcli.spot.install_source import InstallSource, torch_requirement
from drcli.spot.instance_types import InstanceType, default_types, find_types
from drcli.spot.machine_marks import file_key, install_key, stack_folder
from drcli.spot.network import find_images, find_network
from drcli.spot.quotas import check_quotas
from drcli.spot.racer_files import environment, files_to_send
from drcli.spot.role_permissions import Places, run_folders
from drcli.spot.stack_access import subscribe
from drcli.spot.stacks import BUCKET_TAG, ENDS_TAG, Pause, create_stack, refuse_existing
from drcli.spot.training_template import (
    KIND_TAG,
    MODEL_TAG,
    STACK_TAG,
    Group,
    training_template,
)
from drcli.store.s3_bucket import S3Bucket

MOST_TEMPLATE_BYTES = 51_200


@dataclass(frozen=True)
class StackPlan:
    """A training that can be started.

    Attributes:
        resumes: Checkpoint; empty for a new model.
        ends: Unix seconds; 0 for never.
        install: What the machine reads first.
    """

    wishes: Wishes
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


@dataclass(frozen=True)
class CreatedStack:
    """What was started.

    Attributes:
        stack: Name of the stack.
        region: AWS region.
        bucket: Name of the bucket.
        model: Prefix in the bucket.
        types: Types that may be used.
        market: `spot`, `on-demand` or `spot-or-on-demand`.
        usd_per_hour: Cheapest machine now; None if unknown.
        most_usd: Highest cost until the end; None if unknown or unlimited.
        ends: When its machines end, in Unix seconds; 0 for never.
        topic: ARN of the topic for messages.
    """

    stack: str
    region: str
    bucket: str
    model: str
    types: tuple[str, ...]
    market: Market
    usd_per_hour: float | None
    most_usd: float | None
    ends: float
    topic: str


def prepare(
    account: Account, settings: Settings, wishes: Wishes, source: InstallSource
) -> StackPlan:
    """Check everything, and estimate the cost; changes nothing.

    Raises:
        DrError: The training cannot start.
    """
    check_wishes(wishes)
    refuse_existing(account, wishes.stack)
    bucket = check_bucket(account, wishes.bucket)
    resumes, notes = model_state(bucket, settings.model_prefix)
    named = bool(wishes.types)
    names = wishes.types or default_types(wishes.processor)
    network = find_network(account, wishes.subnets)
    types = find_types(account, names, named=named)
    room = check_quotas(account, types, spot=wishes.market != "on-demand")
    notes += room.notes
    if wishes.market == "spot-or-on-demand":
        notes += check_quotas(account, room.types, spot=False).notes
    graphics = [each.name for each in room.types if each.graphics]
    if graphics:
        notes.append(
            f"{', '.join(graphics)} costs more for a graphics card that drcli does not use there."
        )
    prices, ordinary, unknown = known_prices(account, room.types, wishes.market)
    notes += unknown
    images = find_images(account, [each.architecture for each in room.types], wishes.image)
    now = time.time()
    ends = float(int(now + 60 * wishes.ttl_minutes)) if wishes.ttl_minutes else 0.0
    group = Group(
        types={each.name: each.architecture for each in room.types},
        images=images,
        subnets=network.subnets,
        network=network.id,
        market=wishes.market,
        most_usd=wishes.most_usd,
        ends=ends,
        disk_gb=wishes.disk_gb,
        key_name=wishes.key_name,
    )
    places = _places(account, settings, wishes)
    template = training_template(wishes.stack, settings.model_prefix, group, places, wishes.topic)
    if len(json.dumps(template)) > MOST_TEMPLATE_BYTES:
        raise SettingsError(
            f"{len(room.types)} types make a template that is too large for CloudFormation.",
            remedy="Name fewer types with --type.",
        )
    files = files_to_send(settings)
    return StackPlan(
        wishes,
        settings,
        source,
        tuple(room.types),
        network.zones,
        estimate(prices, wishes),
        resumes,
        ends,
        tuple(notes),
        template,
        _install(account, settings, wishes, source, files, ordinary),
        files,
    )


def carry_out(account: Account, plan: StackPlan, pause: Pause = time.sleep) -> CreatedStack:
    """Send the files, and make the stack; a failure removes them.

    Raises:
        StorageError: The bucket or Amazon failed.
    """
    wishes, name = plan.wishes, plan.wishes.stack
    bucket = account.bucket(wishes.bucket)
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
            BUCKET_TAG: wishes.bucket,
            ENDS_TAG: f"{plan.ends:.0f}",
        }
        stack = create_stack(account, name, plan.template, tags, roles=True, pause=pause)
    except BaseException:
        with suppress(DrError):
            forget_files(bucket, name)
        raise
    if wishes.email:
        subscribe(account, stack.outputs["Topic"], wishes.email)
    return CreatedStack(
        name,
        account.region,
        wishes.bucket,
        plan.settings.model_prefix,
        tuple(each.name for each in plan.types),
        wishes.market,
        plan.estimate.least,
        plan.estimate.total,
        stack.ends,
        stack.outputs["Topic"],
    )


def forget_files(bucket: S3Bucket, stack: str) -> int:
    found = [info.key for info in bucket.list(stack_folder(stack))]
    bucket.delete(found)
    return len(found)


def _places(account: Account, settings: Settings, wishes: Wishes) -> Places:
    own_files = {
        key.rpartition("/")[0]
        for key in (settings.reward_key, settings.hyperparameters_key, settings.model_metadata_key)
    }
    folders = {
        *run_folders(settings.model_prefix),
        settings.metrics_prefix,
        settings.custom_files_prefix,
        stack_folder(wishes.stack).rstrip("/"),
        *(folder for folder in own_files if folder),
    }
    upload = settings.upload_s3_bucket
    elsewhere = upload not in ("not-defined", "", wishes.bucket)
    if not elsewhere:
        folders.add(settings.upload_s3_prefix)
    reads = (settings.pretrained_prefix,) if settings.pretrained else ()
    return Places(
        wishes.bucket,
        tuple(sorted(folders)),
        reads,
        upload if elsewhere else "",
        settings.upload_s3_prefix if elsewhere else "",
        key_of(account, wishes.bucket),
        settings.cloud_watch_log_group if settings.cloud_watch_enable else "",
    )


def _install(
    account: Account,
    settings: Settings,
    wishes: Wishes,
    source: InstallSource,
    files: Mapping[str, bytes],
    ordinary: Mapping[str, float],
) -> dict[str, Any]:
    priced = "DR_SPOT_PRICE" in settings.sources or "DR_SPOT_PRICE" in settings.extra
    upload = settings.upload_s3_bucket
    return {
        "source": source.requirement,
        "wheel": source.wheel,
        "sha256": source.sha256,
        "torch": torch_requirement(),
        "packages": list(source.packages),
        "files": sorted(files),
        "environment": environment(wishes.bucket, account.region, wishes.stack, upload),
        "given": ["DR_SPOT_PRICE"] if priced else [],
        "on_demand_usd": dict(ordinary),
        "continues": settings.continue_on_spot_interruption,
        "model": settings.model_prefix,
    }
