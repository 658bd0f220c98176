"""Records in the bucket while a training runs: its owner, what each worker does, and its end."""

from dataclasses import dataclass
from typing import Any

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class ActivityRecord(JsonRecord):
    """The activity of one worker, in a few words, and since when, in Unix seconds."""

    activity: str
    since: float
    pid: int
    host: str


@dataclass(frozen=True)
class TrainingEnd(JsonRecord):
    """Written by the trainer at its end: which start of the training ended, and why."""

    session: str
    reason: str


@dataclass(frozen=True)
class Lease(JsonRecord):
    """Who trains on a prefix.

    Attributes:
        session: Unique name of the start that owns the prefix.
        host: Name of its machine, for people.
        pid: Its supervisor there.
        renewed: Unix seconds by the clock of that machine.
        machine: Different on every machine and in every container; empty if unknown.
        pid_started: When that process began there.
        term: Counts the owners of the prefix. Of two leases the one with the higher term is right:
            an owner that was suspended may write its lease once more after it lost the prefix.
        trainer: Number of the trainer process of this session that may write. An earlier one may
            still live on another machine.
        released: Whether the owner has ended. The record stays, so that an earlier owner that was
            suspended for so long still learns that there was another one.
        age_s: How long ago it was written; not in the file.
        newer: Whether a newer version of drcli wrote it; not in the file. Only then nothing else
            about the owner is known.
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
        """A lease that only a newer version of drcli can read."""
        return Lease(session="of a newer drcli", host="a newer drcli", pid=0, renewed=0, newer=True)

    def to_json(self) -> dict[str, Any]:
        """The record without its age, and without `newer`."""
        fields = super().to_json()
        del fields["age_s"], fields["newer"]
        return fields

    @property
    def owner(self) -> str:
        """The process that wrote it, for people."""
        return "a newer version of drcli" if self.newer else f"process {self.pid} on {self.host}"

    def outranks(self, session: str, term: int) -> bool:
        """Whether the start that owned the prefix in this term has lost it to the lease's owner."""
        if self.newer:
            return True
        return self.session != session and self.term >= term
