"""What a training and the simulation workers that join it from elsewhere tell each other."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import JsonRecord, RecordError


@dataclass(frozen=True)
class JoinRecord(JsonRecord):
    """What a simulation worker needs to join a training: written at each start of the training.

    Attributes:
        session: Of that start.
        versions: Of drcli and of the libraries whose versions decide what a car does, by name.
        tracks: SHA-256 of the route files of all worlds, by DR_WORLD_NAME.
        job: The `Job` of the training, without secrets.
    """

    session: str
    versions: Mapping[str, str]
    tracks: Mapping[str, str]
    job: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MemberRecord(JsonRecord):
    """A simulation worker that has joined a training, which renews this record as long as it lives.

    Nobody compares its clock with another one: whoever reads the record sees that it changes.

    Attributes:
        member: Unique name of the worker, which it keeps when its process is started again.
        session: The start of the training that it works for.
        host: Name of its machine, for people.
        pid: Its process there.
        beat: Counts the renewals.
        ready: Whether it has prepared everything that it needs to drive.
        checkpoint: Number of the newest checkpoint that it has seen; -1 before the first.
        drives: The iteration that it drives now; -1 while it drives none.
        steps: How many steps of it have begun, of all its cars together.
        drive_s: For how long it drives it.
        failure: Why it has ended, if it has failed.
    """

    member: str
    session: str
    host: str
    pid: int
    beat: int = 0
    ready: bool = False
    checkpoint: int = -1
    failure: str = ""
    drives: int = -1
    steps: int = 0
    drive_s: float = 0.0


@dataclass(frozen=True)
class WorkerShare:
    """The training episodes of one worker in an iteration.

    Attributes:
        worker: Its number.
        member: Its name if it has joined; empty for a worker of the training's own machine.
        first: Number of its first episode, counted from the beginning of the training.
        count: How many episodes.
    """

    worker: int
    member: str
    first: int
    count: int

    def __post_init__(self) -> None:
        if min(self.worker, self.first, self.count) < 0:
            raise RecordError("a share has no negative numbers")


@dataclass(frozen=True)
class Shares:
    """Who drives which episodes, from one iteration until the next `Shares`.

    Attributes:
        version: Counts them.
        checkpoint: Number of the checkpoint with which they were published.
        iteration: The first iteration that they are for: one that nobody drives without knowing
            that checkpoint. The numbers of the episodes count from there.
        workers: By number. The first one also evaluates.
    """

    version: int
    checkpoint: int
    iteration: int
    workers: tuple[WorkerShare, ...] = ()

    def of(self, worker: int) -> WorkerShare | None:
        """The share of this worker; None if it has none."""
        return next((share for share in self.workers if share.worker == worker), None)


@dataclass(frozen=True)
class SharesRecord(JsonRecord):
    """The newest shares of a training, of which the trainer is the only writer.

    Attributes:
        session: Of the training.
        numbers: The number of each joined worker, by its name.
        newest: The last few shares, the newest last.
    """

    session: str
    numbers: Mapping[str, int] = field(default_factory=dict)
    newest: tuple[Shares, ...] = ()

    def at(self, iteration: int) -> Shares | None:
        """Who drives an iteration; None if that is not known."""
        fits = [shares for shares in self.newest if shares.iteration <= iteration]
        return fits[-1] if fits else None
