"""How many processor threads the account may run."""

from collections.abc import Sequence
from dataclasses import dataclass

from drcli.base.errors import DrError, SettingsError
from drcli.spot.aws_account import Account
from drcli.spot.instance_types import InstanceType

_STANDARD = frozenset("acdhimrtz")
_GRAPHICS = ("g", "vt")

_CODES = {
    ("standard", True): "L-34B43A08",
    ("standard", False): "L-1216C47A",
    ("graphics", True): "L-3819A6DF",
    ("graphics", False): "L-DB2E81BA",
}


@dataclass(frozen=True)
class Room:
    types: list[InstanceType]
    notes: list[str]


def check_quotas(account: Account, types: Sequence[InstanceType], *, spot: bool) -> Room:
    """Leave out types larger than the free quota.

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
    return Room([each for each in types if each in kept], notes)


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
