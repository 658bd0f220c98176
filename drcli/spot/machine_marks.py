"""What the machines of a stack write into the bucket about themselves, and where."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from drcli.base.json_record import JsonRecord, RecordError
from drcli.store.bucket import Bucket, ObjectMissing

MachineState = Literal[
    "booting",
    "starting",
    "training",
    "waiting",
    "restarting",
    "interrupted",
    "finished",
    "stopped",
    "failed",
]

ENDED: tuple[MachineState, ...] = ("finished", "stopped", "failed", "interrupted")
"""States after which the machine goes away."""


@dataclass(frozen=True)
class MachineMark(JsonRecord):
    """How a machine is.

    Attributes:
        instance: Its id.
        market: `spot` or `on-demand`.
        price: USD per hour; 0 if unknown.
        started: When it first wrote, in Unix seconds.
        written: When it wrote this, in Unix seconds.
        text: A sentence, or empty.
    """

    instance: str
    type: str
    zone: str
    market: str
    price: float
    started: float
    written: float
    state: MachineState
    text: str = ""


def stack_folder(stack: str) -> str:
    """Folder in the bucket with everything that belongs to the machines of a stack."""
    return f"spot/{stack}/"


def install_key(stack: str) -> str:
    """What to install, and which files there are."""
    return stack_folder(stack) + "install.json"


def file_key(stack: str, name: str) -> str:
    """A file of the racer's working folder."""
    return f"{stack_folder(stack)}files/{name}"


def log_folder(stack: str) -> str:
    """Folder with the boot logs."""
    return stack_folder(stack) + "logs/"


def read_marks(bucket: Bucket, stack: str) -> list[MachineMark]:
    """The marks of all machines that the stack has had, the oldest first.

    Damaged ones are left out.
    """
    found = []
    for info in bucket.list(f"{stack_folder(stack)}machines/"):
        with suppress(ObjectMissing, RecordError):
            found.append(MachineMark.decode(bucket.get(info.key)))
    return sorted(found, key=lambda mark: mark.started)
