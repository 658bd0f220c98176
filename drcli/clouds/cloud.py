"""Notices in one form for all clouds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, Protocol

Kind = Literal["interruption", "rebalance"]

LEAVING_S = 60.0
"""Assumed for an end announced without a time."""


@dataclass(frozen=True)
class Notice:
    """Something takes this machine away, or may do so soon.

    Attributes:
        source: Name of a cloud, "command" or "signal".
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

    def is_spot(self) -> bool:
        """Whether this machine may be taken away.

        Raises:
            MetadataSilent: No usable answer.
        """


@dataclass(frozen=True)
class Cloud:
    """A module in `providers` has one, as `CLOUD`.

    Attributes:
        name: In DR_INTERRUPTION_WATCH.
        title: For people.
        variable: With the address of its metadata service; machines that have it are its own.
        owns: By the texts in `registry.DMI_FOLDER` by name.
        source: By the environment and an address, which may be empty. None if the environment
            forbids asking. Raises SettingsError if the address is wrong.
    """

    name: str
    title: str
    variable: str
    owns: Callable[[Mapping[str, str]], bool]
    source: Callable[[Mapping[str, str], str], NoticeSource | None]


def moment(value: object) -> float | None:
    from email.utils import parsedate_to_datetime

    text = str(value or "")
    for read in (datetime.fromisoformat, parsedate_to_datetime):
        try:
            found = read(text)
        except (ValueError, TypeError, IndexError):
            continue
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    return None
