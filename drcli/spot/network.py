"""Network and disk image of machines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drcli.base.errors import SettingsError, StorageError
from drcli.spot.aws_account import Account
from drcli.spot.training_template import Architecture, Image
from drcli.store.s3_errors import error_code

IMAGE_NAMES: Mapping[Architecture, str] = {
    "x86_64": "/aws/service/canonical/ubuntu/server/24.04/stable/current/amd64/hvm/ebs-gp3/ami-id",
    "arm64": "/aws/service/canonical/ubuntu/server/24.04/stable/current/arm64/hvm/ebs-gp3/ami-id",
}
"""Canonical's public parameters."""

_MISSING = frozenset(
    {
        "ParameterNotFound",
        "InvalidAMIID.NotFound",
        "InvalidAMIID.Malformed",
    }
)


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
    from botocore.exceptions import ClientError

    filters = [{"Name": "default-for-az", "Values": ["true"]}]
    asked = {"SubnetIds": list(subnets)} if subnets else {"Filters": filters}
    with account.trying(f"look for networks in {account.region}"):
        try:
            found = account.pages("ec2", "describe_subnets", "Subnets", **asked)
        except ClientError as error:
            if not error_code(error).startswith("InvalidSubnetID"):
                raise
            found = []
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
    from botocore.exceptions import ClientError

    found: dict[Architecture, Image] = {}
    for kind in dict.fromkeys(kinds):
        with account.trying("look for the image of Ubuntu 24.04"):
            try:
                name = image or IMAGE_NAMES[kind]
                if not image:
                    answer = account.client("ssm").get_parameter(Name=name)
                    name = answer["Parameter"]["Value"]
                entries = account.client("ec2").describe_images(ImageIds=[name])["Images"]
            except ClientError as error:
                if error_code(error) not in _MISSING:
                    raise
                entries = []
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
