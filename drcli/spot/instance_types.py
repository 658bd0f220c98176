"""Types of machines that train."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from drcli.base.errors import SettingsError
from drcli.spot.aws_account import Account
from drcli.spot.training_template import Architecture
from drcli.store.s3_errors import error_code

Processor = Literal["x86", "arm", "any"]

X86_TYPES = (
    "c7i.xlarge",
    "c7i.2xlarge",
    "c8i.xlarge",
    "c7a.xlarge",
    "c7a.2xlarge",
    "m7i.xlarge",
    "m7i.2xlarge",
    "m7a.xlarge",
    "r7i.xlarge",
    "c6i.2xlarge",
)
"""4 to 8 threads; training needs no GPU. c7i, c8i, m7i and r7i have AMX, which the trainer uses.
With many types, a free and cheap one is likely.
"""

ARM_TYPES = (
    "c7g.xlarge",
    "c7g.2xlarge",
    "c8g.xlarge",
    "c8g.2xlarge",
    "m7g.xlarge",
    "m8g.xlarge",
)

LEAST_MEMORY_MB = 3_500
THREADS_PER_WORKER = 2


@dataclass(frozen=True)
class InstanceType:
    """`threads` are vCPUs, in which quotas are counted."""

    name: str
    architecture: Architecture
    threads: int
    memory_mb: int
    graphics: bool = False

    @property
    def workers(self) -> int:
        return max(1, self.threads // THREADS_PER_WORKER)


def default_types(processor: Processor) -> tuple[str, ...]:
    return {"x86": X86_TYPES, "arm": ARM_TYPES, "any": (*X86_TYPES, *ARM_TYPES)}[processor]


def find_types(account: Account, names: Sequence[str], *, named: bool) -> list[InstanceType]:
    """The types that the region has, in order.

    Raises:
        SettingsError: A type of the racer (`named`) does not exist there, or is too small.
    """
    offered = _offered(account, names)
    if named and (missing := [name for name in names if name not in offered]):
        raise SettingsError(
            f"The region {account.region} has no machine of type {', '.join(missing)}.",
            remedy="Correct the name (--type, DEEPRACER_INSTANCE_TYPE), or choose another region "
            "with --region; `dr-spot prices --type NAME` shows where there are some.",
        )
    known = [name for name in dict.fromkeys(names) if name in offered]
    if not known:
        raise SettingsError(
            f"The region {account.region} has none of the types {', '.join(names)}.",
            remedy="Choose another region with --region, or types with --type.",
        )
    with account.trying("read about types of machines"):
        asked = {"InstanceTypes": known}
        found = account.pages("ec2", "describe_instance_types", "InstanceTypes", **asked)
    facts = {entry["InstanceType"]: _type(entry) for entry in found}
    types = [facts[name] for name in known if name in facts]
    small = [each.name for each in types if each.memory_mb < LEAST_MEMORY_MB]
    if small and named:
        raise SettingsError(
            f"A machine of type {', '.join(small)} has too little memory for a training.",
            remedy=f"Choose types with at least {LEAST_MEMORY_MB / 1024:.1f} GB, such as "
            f"{X86_TYPES[0]}.",
        )
    return types


def _offered(account: Account, names: Sequence[str]) -> set[str]:
    from botocore.exceptions import ClientError

    asked = {
        "LocationType": "region",
        "Filters": [{"Name": "instance-type", "Values": list(names)}],
    }
    with account.trying("list the types of machines in the region"):
        try:
            found = account.pages(
                "ec2", "describe_instance_type_offerings", "InstanceTypeOfferings", **asked
            )
        except ClientError as error:
            if error_code(error) == "InvalidInstanceType":
                return set()
            raise
    return {entry["InstanceType"] for entry in found}


def _type(entry: Mapping[str, Any]) -> InstanceType:
    return InstanceType(
        entry["InstanceType"],
        "arm64" if "arm64" in entry["ProcessorInfo"]["SupportedArchitectures"] else "x86_64",
        entry["VCpuInfo"]["DefaultVCpus"],
        entry["MemoryInfo"]["SizeInMiB"],
        bool(entry.get("GpuInfo")),
    )
