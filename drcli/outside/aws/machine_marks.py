"""What machines write into the bucket about themselves."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from drcli.base.json_record import JsonRecord, RecordError
from drcli.bucket.bucket import Bucket, ObjectMissing

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


@dataclass(frozen=True)
class MachineMark(JsonRecord):
    """A machine's state; `started` and `written` are Unix seconds, an unknown price is 0."""

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
    return f"spot/{stack}/"


def install_key(stack: str) -> str:
    return stack_folder(stack) + "install.json"


def file_key(stack: str, name: str) -> str:
    return f"{stack_folder(stack)}files/{name}"


def log_folder(stack: str) -> str:
    return stack_folder(stack) + "logs/"


def read_marks(bucket: Bucket, stack: str) -> list[MachineMark]:
    """The undamaged ones, the oldest first."""
    found = []
    for info in bucket.list(f"{stack_folder(stack)}machines/"):
        with suppress(ObjectMissing, RecordError):
            found.append(MachineMark.decode(bucket.get(info.key)))
    return sorted(found, key=lambda mark: mark.started)
