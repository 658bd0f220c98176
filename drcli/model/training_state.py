"""Records of joined simulation workers, as the trainer reads them."""

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

from drcli.base import errors
from drcli.base.json_record import JsonRecord, Seconds
from drcli.bucket.bucket import (
    READS_FAR,
    ObjectDamaged,
    ObjectInfo,
    find_record,
    readable_record,
    readable_records,
)
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName, CheckpointRecord, checkpoint_name
from drcli.records.job import MemberRecord, Shares, SharesRecord
from drcli.records.reward import RewardErrorRecord
from drcli.records.training_record import RunOutcome

RENEWED_S = 5.0
GONE_S = 20.0
"""A worker that did not renew its record for so long is gone."""

MISSED_S = 2.0 * RENEWED_S
"""After two missed renewals, a worker is not waited for."""

FORGOTTEN_S = 600.0
"""Then the record is deleted and the worker loses its number."""


def read_shares_record(model: ModelStore) -> SharesRecord | None:
    """None before a worker joined, or if damaged."""
    with suppress(ObjectDamaged):
        return find_record(model.bucket, keys.shares(model.prefix), SharesRecord.decode)
    return None


def read_shares(model: ModelStore, session: str, iteration: int) -> Shares | None:
    record = read_shares_record(model)
    return record.at(iteration) if record is not None and record.session == session else None


@dataclass(frozen=True)
class Member:
    record: MemberRecord
    silent_s: float

    @property
    def is_alive(self) -> bool:
        return self.silent_s < GONE_S


@dataclass(frozen=True)
class _Seen:
    modified: datetime
    record: MemberRecord
    seen_s: float


class MemberReader:
    """Reads records of one session; only changed ones cost a request."""

    def __init__(
        self,
        model: ModelStore,
        session: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._model = model
        self._session = session
        self._clock = clock
        self._seen: dict[str, _Seen] = {}

    def _records(self, changed: Mapping[str, ObjectInfo]) -> dict[str, MemberRecord | None]:
        def read(info: ObjectInfo) -> MemberRecord | None:
            return readable_record(self._model.bucket, info.key, MemberRecord.decode)

        if len(changed) < 2:
            return {name: read(info) for name, info in changed.items()}
        with ThreadPoolExecutor(min(READS_FAR, len(changed))) as readers:
            return dict(zip(changed, readers.map(read, changed.values()), strict=True))

    def read(self) -> dict[str, Member]:
        found: dict[str, _Seen] = {}
        changed: dict[str, ObjectInfo] = {}
        for info in self._model.bucket.list(keys.members_folder(self._model.prefix)):
            name = keys.member_of(self._model.prefix, info.key)
            if name is None:
                continue
            before = self._seen.get(name)
            if before is not None and before.modified == info.modified:
                found[name] = before
            else:
                changed[name] = info
        for name, record in self._records(changed).items():
            before = self._seen.get(name)
            if record is None:
                if before is not None:  # it is just written, or damaged
                    found[name] = before
                continue
            unchanged = before is not None and before.record == record
            seen_s = before.seen_s if before is not None and unchanged else self._clock()
            found[name] = _Seen(changed[name].modified, record, seen_s)
        self._seen = found
        now_s = self._clock()
        members = {name: Member(each.record, now_s - each.seen_s) for name, each in found.items()}
        old = [name for name, member in members.items() if member.silent_s >= FORGOTTEN_S]
        self._model.bucket.delete([keys.member(self._model.prefix, name) for name in old])
        return {
            name: member
            for name, member in members.items()
            if member.record.session == self._session and name not in old
        }


# Reads the counted failures of a reward function.


def read_reward_errors(model: ModelStore) -> list[RewardErrorRecord]:
    """By worker, without damaged ones.

    Raises:
        StorageError: The bucket does not answer.
    """
    folder = keys.reward_errors_folder(model.prefix)
    found = readable_records(model.bucket, folder, RewardErrorRecord.decode)
    return sorted(found, key=lambda record: record.worker)


# How often and why a training went back to an older checkpoint.


RATE_FACTOR = 1.0 / 3.0
Reason = Literal["nan", "collapse"]


@dataclass(frozen=True)
class Rollback:
    """One return to an older checkpoint.

    Attributes:
        at: Unix seconds.
        reason: A loss or weight that is NaN or infinite, or a policy that is far worse.
        text: What was wrong, a sentence without its full stop.
        left: Name of the checkpoint that was the newest.
        target: Name of the checkpoint from which the training goes on.
        lr: `lr` of hyperparameters.json at that time.
        factor: The learning rate since then, as a share of `lr`.
        elapsed_s: Wall time of training until then, with the given up iterations.
        session: The start that went back.
    """

    at: float
    reason: Reason
    text: str
    left: str
    target: str
    lr: float
    factor: float
    elapsed_s: Seconds
    session: str = ""

    def __post_init__(self) -> None:
        checkpoint_name(self.left)
        checkpoint_name(self.target)

    @property
    def sentence(self) -> str:
        """For people."""
        left, target = checkpoint_name(self.left), checkpoint_name(self.target)
        if left.number == target.number:
            back = f"The update of checkpoint {target.number} is repeated"
        else:
            back = f"Went back from checkpoint {left.number} to {target.number}"
        return f"{self.text}. {back} with a learning rate of {self.lr * self.factor:.3g}."

    def facts(self) -> Mapping[str, object]:
        """For programs, in the journal."""
        return {
            "reason": self.reason,
            "left": self.left,
            "target": self.target,
            "learning_rate": self.lr * self.factor,
        }


@dataclass(frozen=True)
class Rollbacks(JsonRecord):
    """All rollbacks of a model, oldest first. Only its trainer writes them.

    A rollback happens when it is written here; a trainer that starts in between completes it.
    Checkpoints and rollouts count the rollbacks before them, so nothing given up seems new.
    """

    entries: list[Rollback] = field(default_factory=list)

    @property
    def count(self) -> int:
        return len(self.entries)

    @property
    def elapsed_s(self) -> float:
        return self.entries[-1].elapsed_s if self.entries else 0.0

    def factor(self, lr: float) -> float:
        """Of `lr`; 1 once somebody changed it."""
        last = self.entries[-1] if self.entries else None
        return 1.0 if last is None or last.lr != lr else last.factor

    def pending(self, newest: CheckpointRecord) -> CheckpointName | None:
        """Where to go on, if the newest checkpoint was given up."""
        if not self.entries or (newest.counters.rollbacks or 0) >= self.count:
            return None
        target = checkpoint_name(self.entries[-1].target)
        return target if newest.number > target.number else None

    def allows(self, checkpoint: int, rollbacks: int) -> bool:
        """Whether a checkpoint, published after so many, still counts."""
        later = self.entries[max(0, rollbacks) :]
        return all(checkpoint <= checkpoint_name(each.target).number for each in later)


NO_ROLLBACKS = Rollbacks()


# Reads and writes the rollbacks of a model.


def read_rollbacks(model: ModelStore) -> Rollbacks:
    found = find_record(model.bucket, keys.rollbacks(model.prefix), Rollbacks.decode)
    return found or Rollbacks()


def write_rollbacks(model: ModelStore, rollbacks: Rollbacks) -> None:
    """With this write, the newest one has happened."""
    model.bucket.put(keys.rollbacks(model.prefix), rollbacks.encode())


# What the newest start of a run came to.


def read_outcome(model: ModelStore) -> RunOutcome | None:
    """None if missing or damaged, as after the loss of a machine.

    Raises:
        ObjectNewer: A newer drcli wrote it.
    """
    try:
        return find_record(model.bucket, keys.outcome(model.prefix), RunOutcome.decode)
    except ObjectDamaged as error:
        errors.warn(f"{error} {error.remedy}")
        return None


def write_outcome(model: ModelStore, outcome: RunOutcome) -> None:
    model.bucket.put(keys.outcome(model.prefix), outcome.encode())
