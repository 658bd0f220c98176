"""Types of machines that train."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.training_template import Architecture, Image

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
    asked = {
        "LocationType": "region",
        "Filters": [{"Name": "instance-type", "Values": list(names)}],
    }
    found: list[Any] = []
    with account.trying(
        "list the types of machines in the region", unless=("InvalidInstanceType",)
    ):
        found = account.pages(
            "ec2", "describe_instance_type_offerings", "InstanceTypeOfferings", **asked
        )
    return {entry["InstanceType"] for entry in found}


def _type(entry: Mapping[str, Any]) -> InstanceType:
    return InstanceType(
        entry["InstanceType"],
        "arm64" if "arm64" in entry["ProcessorInfo"]["SupportedArchitectures"] else "x86_64",
        entry["VCpuInfo"]["DefaultVCpus"],
        entry["MemoryInfo"]["SizeInMiB"],
        bool(entry.get("GpuInfo")),
    )


# Network and disk image of machines.


IMAGE_NAMES: Mapping[Architecture, str] = {
    "x86_64": "/aws/service/canonical/ubuntu/server/24.04/stable/current/amd64/hvm/ebs-gp3/ami-id",
    "arm64": "/aws/service/canonical/ubuntu/server/24.04/stable/current/arm64/hvm/ebs-gp3/ami-id",
}
"""Canonical's public parameters."""

_NO_IMAGE = ("ParameterNotFound", "InvalidAMIID.NotFound", "InvalidAMIID.Malformed")
_NO_SUBNET = ("InvalidSubnetID.NotFound", "InvalidSubnetID.Malformed", "InvalidSubnetId.Malformed")


@dataclass(frozen=True)
class Network:
    id: str
    subnets: tuple[str, ...]
    zones: tuple[str, ...]


def find_network(account: Account, subnets: Sequence[str]) -> Network:
    """The named subnets, or the default network's: one per zone.

    Raises:
        SettingsError: None, or not of one network.
    """
    filters = [{"Name": "default-for-az", "Values": ["true"]}]
    asked = {"SubnetIds": list(subnets)} if subnets else {"Filters": filters}
    found: list[Any] = []
    with account.trying(f"look for networks in {account.region}", unless=_NO_SUBNET):
        found = account.pages("ec2", "describe_subnets", "Subnets", **asked)
    networks = {entry["VpcId"] for entry in found}
    if len(networks) != 1 or len(found) < len(set(subnets)):
        missing = "a default network"
        if subnets:
            missing = f"one network with the subnets {', '.join(subnets)}"
        raise SettingsError(
            f"{account.region} does not have {missing}.",
            remedy="Name subnets with --subnet, or make a default network with "
            f"`aws ec2 create-default-vpc --region {account.region}`.",
        )
    found.sort(key=lambda entry: entry["AvailabilityZone"])
    return Network(
        networks.pop(),
        tuple(entry["SubnetId"] for entry in found),
        tuple(entry["AvailabilityZone"] for entry in found),
    )


def find_images(
    account: Account, kinds: Sequence[Architecture], image: str
) -> dict[Architecture, Image]:
    """The named image or the newest Ubuntu 24.04, by architecture.

    Raises:
        SettingsError: It does not exist, or is for other processors.
    """
    found: dict[Architecture, Image] = {}
    for kind in dict.fromkeys(kinds):
        entries: list[Any] = []
        with account.trying("look for the image of Ubuntu 24.04", unless=_NO_IMAGE):
            name = image or IMAGE_NAMES[kind]
            if not image:
                answer = account.client("ssm").get_parameter(Name=name)
                name = answer["Parameter"]["Value"]
            entries = account.client("ec2").describe_images(ImageIds=[name])["Images"]
        if not entries:
            raise StorageError(
                f"There is no image {image or IMAGE_NAMES[kind]} in {account.region}.",
                remedy="Name one with --image, or choose another region with --region.",
            )
        if entries[0].get("Architecture", kind) != kind:
            raise SettingsError(
                f"The image {image} is for {entries[0]['Architecture']}, not for {kind}.",
                remedy="Choose types that fit the image with --type or --processor.",
            )
        found[kind] = Image(entries[0]["ImageId"], entries[0].get("RootDeviceName") or "/dev/sda1")
    return found


# How many processor threads the account may run.


_STANDARD = frozenset("acdhimrtz")
_GRAPHICS = ("g", "vt")

_CODES = {
    ("standard", True): "L-34B43A08",
    ("standard", False): "L-1216C47A",
    ("graphics", True): "L-3819A6DF",
    ("graphics", False): "L-DB2E81BA",
}


def check_quotas(
    account: Account, types: Sequence[InstanceType], *, spot: bool
) -> tuple[list[InstanceType], list[str]]:
    """Leave out types larger than the free quota; types and notes.

    Raises:
        SettingsError: None fits.
    """
    kept: list[InstanceType] = []
    notes: list[str] = []
    refusals: list[str] = []
    for family in dict.fromkeys(_family(each.name) for each in types):
        members = [each for each in types if _family(each.name) == family]
        limit = _limit(account, family, spot=spot, notes=notes)
        if limit is None:
            kept += members
            continue
        used = _used(account, family, spot=spot, notes=notes)
        fitting = [each for each in members if each.threads <= limit - used]
        kept += fitting
        large = [each.name for each in members if each not in fitting]
        code = _CODES[family, spot]
        what = (
            f"your quota {code} allows {limit:.0f} vCPUs for {family} "
            f"{'spot' if spot else 'on-demand'} machines in {account.region}, and {used} are used"
        )
        if large and fitting:
            notes.append(f"{', '.join(large)} left out: {what}.")
        elif large:
            smallest = min(each.threads for each in members)
            refusals.append(f"{what}; the smallest of these types has {smallest}")
    if not kept:
        raise SettingsError(
            f"No machine may be started: {'; '.join(refusals)}.",
            remedy=f"Ask for more at https://{account.region}.console.aws.amazon.com/servicequotas/"
            "home/services/ec2/quotas (it takes hours to days), choose smaller types with --type, "
            "or another region with --region.",
        )
    return [each for each in types if each in kept], notes


def _family(name: str) -> str:
    stem = name.partition(".")[0]
    if stem.startswith(_GRAPHICS):
        return "graphics"
    return "standard" if stem[:1] in _STANDARD else "other"


def _limit(account: Account, family: str, *, spot: bool, notes: list[str]) -> float | None:
    code = _CODES.get((family, spot))
    if code is None:
        return None
    try:
        with account.trying(f"read your quota {code}"):
            answer = account.client("service-quotas").get_service_quota(
                ServiceCode="ec2", QuotaCode=code
            )
            return float(answer["Quota"]["Value"])
    except DrError as error:
        notes.append(f"{error} If it is too small, no machine will start.")
        return None


def _used(account: Account, family: str, *, spot: bool, notes: list[str]) -> int:
    states = [{"Name": "instance-state-name", "Values": ["pending", "running", "stopping"]}]
    try:
        with account.trying("count the machines that run"):
            found = account.pages("ec2", "describe_instances", "Reservations", Filters=states)
    except DrError as error:
        notes.append(str(error))
        return 0
    machines = [each for entry in found for each in entry["Instances"]]
    return sum(
        int(each.get("CpuOptions", {}).get("CoreCount", 1))
        * int(each.get("CpuOptions", {}).get("ThreadsPerCore", 1))
        for each in machines
        if (each.get("InstanceLifecycle") == "spot") == spot
        and _family(each["InstanceType"]) == family
    )
