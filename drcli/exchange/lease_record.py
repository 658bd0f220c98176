"""The lease: a record in the bucket that says who trains on a model prefix."""

from dataclasses import dataclass
from typing import Any

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class Lease(JsonRecord):
    """Who trains on a prefix.

    Attributes:
        session: Unique name of the start that owns the prefix.
        host: Name of its machine, for people.
        pid: Its supervisor there.
        renewed: Unix seconds by the clock of that machine.
        machine: What no other machine or container has, empty where it is not known.
        pid_started: When that process began there.
        term: Counts the owners of the prefix. Of two leases the one with the higher term is right:
            an owner that was held up may write its lease once more after it lost the prefix.
        released: Whether the owner has ended. The record stays, so that one who owned the prefix
            before, and was held up all the while, still learns that there was another.
        age_s: How long ago it was written; not part of what is written.
    """

    session: str
    host: str
    pid: int
    renewed: float
    machine: str = ""
    pid_started: float = 0.0
    term: int = 0
    released: bool = False
    age_s: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """The record without its age."""
        fields = super().to_json()
        del fields["age_s"]
        return fields

    def outranks(self, session: str, term: int) -> bool:
        """Whether a start that owned the prefix in some term has lost it to this one."""
        return self.session != session and self.term >= term
