"""A simulation worker that joins a training, as its trainer and its lease see it.

A thread renews its record in the bucket. The trainer gives it a number, and says with which
checkpoint it drives which episodes. Nobody needs a connection to it.
"""

import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from drcli.base.clock import elapsed_s
from drcli.base.errors import OwnershipLost, StorageError
from drcli.base.log import get_logger
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.lease import STALE_S, read_lease
from drcli.model.model_store import ModelStore
from drcli.model.training_state import RENEWED_S, read_shares_record
from drcli.records.checkpoint import CheckpointName
from drcli.records.job import MemberRecord, Shares, SharesRecord
from drcli.workers.worker_process import StopRequested, StopSignal

_logger = get_logger(__name__)

ASK_S = 1.0
STUCK_S = 120.0
"""Then a worker with an idle main thread no longer renews its record."""


@dataclass
class _Drive:
    iteration: int
    steps: Callable[[], int]
    steps_before: int
    began_s: float
    is_over: bool = False


class Membership:
    """Keeps this worker in the training. Close it at the end.

    `session` is the start to work for, `member` the worker's unique name.
    """

    def __init__(
        self,
        model: ModelStore,
        session: str,
        member: str,
        stop_signal: StopSignal,
        pause: Callable[[float], object] = time.sleep,
    ) -> None:
        self._model = model
        self._stop_signal = stop_signal
        self._pause = pause
        self._record = MemberRecord(member, session, socket.gethostname(), os.getpid())
        self._lock = threading.Lock()
        self._over = False
        self._drive: _Drive | None = None
        self._hurry = threading.Event()
        self._asked_s = -ASK_S
        self._write()
        self._thread = threading.Thread(target=self._renew, name="membership", daemon=True)
        self._thread.start()

    def wait_for_number(self) -> int:
        """Wait until the trainer has given this worker a number.

        Raises:
            StopRequested: Somebody wants this worker to stop, or the training has ended.
        """
        while True:
            if self._stop_signal.should_stop():
                raise StopRequested
            record = self._shares_record()
            number = None if record is None else record.numbers.get(self._record.member)
            if number is not None:
                return number
            self._pause(ASK_S)

    def is_ready(self, checkpoint: int) -> None:
        with self._lock:
            is_first = not self._record.ready
            self._record = replace(self._record, ready=True, checkpoint=checkpoint)
        if is_first:
            self._hurry.set()

    def begin_drive(self, iteration: int, steps: Callable[[], int]) -> None:
        """Let the trainer know how far it is; a thread calls `steps`."""
        self._drive = _Drive(iteration, steps, steps(), elapsed_s())

    def is_drive_over(self) -> bool:
        """Whether the trainer has gone on without this worker's part."""
        return self._drive is not None and self._drive.is_over

    def end_drive(self) -> None:
        self._drive = None

    def shares_of(self, iteration: int) -> Shares | None:
        """Who drives an iteration; None as long as that is not known.

        Raises:
            StorageError: The bucket does not answer.
        """
        record = self._shares_record()
        return None if record is None else record.at(iteration)

    def is_reassigned(self, name: CheckpointName) -> bool:
        """Whether this worker, which had nothing to drive, now has a share."""
        now_s = elapsed_s()
        if now_s - self._asked_s < ASK_S:
            return False
        self._asked_s = now_s
        record = self._shares_record()
        if record is None or not record.newest:
            return False
        # What is in force since longer was known when this worker found nothing to drive.
        newest = record.newest[-1]
        own = [share for share in newest.workers if share.member == self._record.member]
        return newest.iteration <= name.number and bool(own)

    def close(self, failure: str = "") -> None:
        """The trainer tells a `failure`: nobody may look at this machine."""
        if self._over:
            return
        self._over = True
        self._hurry.set()
        self._thread.join(RENEWED_S)
        if failure:
            with self._lock:
                self._record = replace(self._record, ready=False, failure=failure)
            with suppress(StorageError):
                self._write()
            return
        # The trainer notices anyway that the record does not change any more.
        with suppress(StorageError, OwnershipLost):
            self._model.bucket.delete([keys.member(self._model.prefix, self._record.member)])

    def _shares_record(self) -> SharesRecord | None:
        record = read_shares_record(self._model)
        known = record is not None and record.session == self._record.session
        return record if known else None

    def _write(self) -> None:
        drive, (drives, steps, drive_s) = self._drive, (-1, 0, 0.0)
        if drive is not None:
            drives, drive_s = drive.iteration, elapsed_s() - drive.began_s
            steps = drive.steps() - drive.steps_before
        with self._lock:
            beat = self._record.beat + 1
            self._record = record = replace(
                self._record, beat=beat, drives=drives, steps=steps, drive_s=drive_s
            )
        try:
            self._model.bucket.put(keys.member(self._model.prefix, record.member), record.encode())
        except OwnershipLost:
            self._stop_signal.ended = "another start continues it"

    def _renew(self) -> None:
        while True:
            self._hurry.wait(RENEWED_S)
            self._hurry.clear()
            if self._over:
                return
            try:
                self._look_at_lease()
                self._look_at_drive()
                stuck_s = elapsed_s() - self._stop_signal.heartbeat.record().turned_s
                if not self._stop_signal.ended and stuck_s < STUCK_S:
                    self._write()
            except StorageError as error:
                _logger.warning("The record of this worker could not be renewed: %s", error)

    def _look_at_drive(self) -> None:
        drive = self._drive
        if drive is not None:
            newest = CheckpointStore(self._model).pointed()
            drive.is_over = newest is not None and newest.number > drive.iteration

    def _look_at_lease(self) -> None:
        lease = read_lease(self._model)
        if lease is None:  # it is just written again
            return
        if lease.session != self._record.session:
            self._stop_signal.ended = "another start continues it"
        elif lease.released:
            self._stop_signal.ended = "it was ended"
        elif lease.age_s >= STALE_S:
            self._stop_signal.ended = f"its machine was not heard from for {lease.age_s:.0f} s"
