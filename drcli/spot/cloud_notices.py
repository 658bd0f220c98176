"""Interruption notices in one form for all clouds."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

Kind = Literal["interruption", "rebalance"]

Cloud = Literal["aws", "gcp", "azure"]

CLOUD_NAMES: Mapping[Cloud, str] = {
    "aws": "Amazon EC2",
    "gcp": "Google Compute Engine",
    "azure": "Azure",
}

DMI_FOLDER = Path("/sys/class/dmi/id")
AZURE_ASSET_TAG = "7783-7084-3265-9085-8269-3286-77"
"""Of machines at Azure, not of others with Hyper-V. Source: cloud-init."""


@dataclass(frozen=True)
class Notice:
    """Something takes this machine away, or may do so soon.

    Attributes:
        source: aws, gcp, azure, "command" or "signal".
        kind: "interruption" is certain, "rebalance" a recommendation.
    """

    source: str
    kind: Kind
    action: str
    seconds_left: float | None
    text: str


class NoticeSource(Protocol):
    name: str

    def ask(self) -> list[Notice]:
        """What is announced now.

        Raises:
            MetadataSilent: No usable answer.
        """


def cloud_of_machine(environment: Mapping[str, str], dmi: Path = DMI_FOLDER) -> Cloud | None:
    """By mainboard and environment, without network; None for other machines."""
    if environment.get("AWS_EC2_METADATA_SERVICE_ENDPOINT"):
        return "aws"
    if environment.get("GCE_METADATA_HOST"):
        return "gcp"
    vendor, product, tag, firmware = (
        _text(dmi / name)
        for name in ("sys_vendor", "product_name", "chassis_asset_tag", "bios_version")
    )
    if vendor == "Amazon EC2" or firmware.endswith(".amazon"):
        return "aws"
    if vendor == "Google" and product.startswith("Google"):
        return "gcp"
    if tag == AZURE_ASSET_TAG:
        return "azure"
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace").strip()
    except OSError:
        return ""
