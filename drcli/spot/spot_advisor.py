"""Interruption rates from Amazon's public Spot Advisor."""

import os
from dataclasses import dataclass
from typing import Any

from drcli.base.errors import StorageError
from drcli.base.json_record import RecordError, parse_json

ADDRESS = "https://spot-bid-advisor.s3.amazonaws.com/spot-advisor-data.json"
ADDRESS_VARIABLE = "DRCLI_SPOT_ADVISOR_URL"

CLASSES = ("<5%", "5-10%", "10-15%", "15-20%", ">20%")
"""Machines interrupted within a month."""

_TIMEOUT_S = 15.0
_MOST_BYTES = 50_000_000


@dataclass(frozen=True)
class Advisor:
    values: dict[tuple[str, str], str]

    def frequency(self, region: str, name: str) -> str:
        """One of `CLASSES`, or empty."""
        return self.values.get((region, name), "")


def read_advisor() -> Advisor:
    """Read the public file, or the environment's.

    Raises:
        StorageError: It cannot be read.
    """
    import requests

    address = os.environ.get(ADDRESS_VARIABLE) or ADDRESS
    try:
        with requests.get(address, timeout=_TIMEOUT_S, stream=True) as answer:
            answer.raise_for_status()
            data = answer.raw.read(_MOST_BYTES, decode_content=True)
        return advisor_of(parse_json(data))
    except (requests.RequestException, RecordError, OSError, ValueError) as error:
        raise StorageError(
            f"How often machines are interrupted is not known: {address} cannot be read "
            f"({type(error).__name__}).",
            remedy=f"Check the network, or set {ADDRESS_VARIABLE} to a copy of that file.",
        ) from error


def advisor_of(content: Any) -> Advisor:
    """Leaves out entries of unknown form."""
    found: dict[tuple[str, str], str] = {}
    regions = content.get("spot_advisor") if isinstance(content, dict) else None
    for region, systems in _entries(regions):
        for name, facts in _entries(systems.get("Linux") if isinstance(systems, dict) else None):
            number = facts.get("r") if isinstance(facts, dict) else None
            if type(number) is int and 0 <= number < len(CLASSES):
                found[region, name] = CLASSES[number]
    if not found:
        raise RecordError("it names no region with machines")
    return Advisor(found)


def _entries(value: Any) -> list[tuple[str, Any]]:
    return list(value.items()) if isinstance(value, dict) else []
