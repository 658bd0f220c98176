"""What a training and the workers that join it exchange."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import JsonRecord, RecordError


@dataclass(frozen=True)
class JoinRecord(JsonRecord):
    """What a worker needs to join; written by each start.

    Attributes:
        versions: Of what decides how a car drives.
        tracks: SHA-256 of route files, by DR_WORLD_NAME.
        job: The `Job`, without secrets.
    """

    session: str
    versions: Mapping[str, str]
    tracks: Mapping[str, str]
    job: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MemberRecord(JsonRecord):
    """A joined simulation worker, which keeps renewing this.

    Readers compare no clocks: they see that it changes.

    Attributes:
        member: Unique name, kept in restarts.
        checkpoint: Newest seen; -1 before.
        drives: Present iteration; -1 for none.
        steps: Begun in it, of all its cars.
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
    """One worker's episodes in an iteration; `first` counts since the training began."""

    worker: int
    member: str
    first: int
    count: int

    def __post_init__(self) -> None:
        if min(self.worker, self.first, self.count) < 0:
            raise RecordError("a share has no negative numbers")


@dataclass(frozen=True)
class Shares:
    """Who drives which episodes, until the next `Shares`.

    Attributes:
        version: Counts them.
        checkpoint: Published with them.
        iteration: The first that nobody drives without knowing that checkpoint; episodes count
            from there.
        workers: The first also evaluates.
    """

    version: int
    checkpoint: int
    iteration: int
    workers: tuple[WorkerShare, ...] = ()

    def of(self, worker: int) -> WorkerShare | None:
        return next((share for share in self.workers if share.worker == worker), None)


@dataclass(frozen=True)
class SharesRecord(JsonRecord):
    """The newest few shares; only the trainer writes them."""

    session: str
    numbers: Mapping[str, int] = field(default_factory=dict)
    newest: tuple[Shares, ...] = ()

    def at(self, iteration: int) -> Shares | None:
        fits = [shares for shares in self.newest if shares.iteration <= iteration]
        return fits[-1] if fits else None
