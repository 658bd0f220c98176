"""Records in the bucket while a training runs."""

from dataclasses import dataclass
from typing import Any

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class ActivityRecord(JsonRecord):
    activity: str
    since: float
    pid: int
    host: str


@dataclass(frozen=True)
class TrainingEnd(JsonRecord):
    session: str
    reason: str


@dataclass(frozen=True)
class Lease(JsonRecord):
    """Who trains on a prefix.

    Attributes:
        pid: Its supervisor.
        renewed: Unix seconds by its machine's clock.
        machine: Unique for machine and container.
        term: Counts owners. The higher term is right: a suspended owner may write once more.
        trainer: Number of the trainer process that may write; an earlier one may live elsewhere.
        released: The owner has ended. The record stays, so that a suspended owner learns of it.
        newer: A newer drcli wrote it, so nothing else is known; like `age_s`, not in the file.
    """

    session: str
    host: str
    pid: int
    renewed: float
    machine: str = ""
    pid_started: float = 0.0
    term: int = 0
    trainer: int = 0
    released: bool = False
    age_s: float = 0.0
    newer: bool = False

    @staticmethod
    def of_newer() -> "Lease":
        return Lease(session="of a newer drcli", host="a newer drcli", pid=0, renewed=0, newer=True)

    def to_json(self) -> dict[str, Any]:
        fields = super().to_json()
        del fields["age_s"], fields["newer"]
        return fields

    @property
    def owner(self) -> str:
        return "a newer version of drcli" if self.newer else f"process {self.pid} on {self.host}"

    def outranks(self, session: str, term: int) -> bool:
        """Whether the owner of this term has lost the prefix."""
        if self.newer:
            return True
        return self.session != session and self.term >= term
