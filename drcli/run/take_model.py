"""Takes a model: of several starts at the same time, one trains."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.base import errors
from drcli.base.errors import StorageError, TrainedElsewhere
from drcli.base.files import only_writer
from drcli.base.processes import started_s, this_machine
from drcli.checks.start_rules import refuse_second_run
from drcli.model import lease
from drcli.model.lease import STALE_S, is_owner_alive, live_holder, refuse_other_owner
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.records.run_record import Lease, RunRecord, WaitingStart


@contextmanager
def taken(job: Job, model: ModelStore, review: Callable[[], None]) -> Iterator[None]:
    """Take the lease of the model prefix; released if the `with` block fails.

    Raises:
        SettingsError: Another start was faster.
    """
    with only_writer(job.directory):
        refuse_second_run(job.config.run_id, job.folder)
        lease.refuse_other_owner(model, job.session)
        review()
        lease.take(model, job.session)
    try:
        yield
    except BaseException:
        with suppress(StorageError):
            lease.release(model, job.session)
        raise


# Waits until a model's owner has ended, or was silent for a minute.


POLL_S = 2.0
"""While the lease may be that of a dead machine."""

LONG_LOOK_S = 10.0
"""A living owner may train for a day."""


@dataclass
class OwnerWait:
    model: ModelStore
    folder: Path
    wait: bool
    pause: Callable[[float], None] = time.sleep

    def until_free(self) -> None:
        """Return when nobody trains the model.

        Raises:
            TrainedElsewhere: Its owner lives, and nobody wants to wait.
            SettingsError: Its owner is a newer drcli, or this DR_RUN_ID trains another model
                here.
            StorageError: The bucket does not answer at the first look.
        """
        waiting = WaitingStart(
            os.getpid(), started_s(os.getpid()) or 0.0, self.model.bucket.name, self.model.prefix
        )
        with waiting.shown(self.folder):  # the first look may already take long
            if self._owner() is not None:
                self._wait()

    def _wait(self) -> None:
        first: Lease | None = None
        silent = lives = False
        while True:
            try:
                held = self._owner()
            except StorageError as error:
                if not silent:
                    errors.warn(f"{error} Waiting goes on.")
                silent = True
                self.pause(LONG_LOOK_S)
                continue
            silent = False
            if held is None:
                return
            if held.newer:
                refuse_other_owner(self.model)
            model = self.model.url
            if first is None and not self._is_known_to_live(held):
                errors.show(
                    f"{model} belongs to {held.owner}, last heard from {held.age_s:.0f} s ago. "
                    f"Waiting up to {max(0.0, STALE_S - held.age_s):.0f} s, because that machine "
                    "may be gone."
                )
            first = first or held
            renewed = (held.session, held.renewed) != (first.session, first.renewed)
            if not lives and (renewed or self._is_known_to_live(held)):
                lives = True
                if not self.wait:
                    raise TrainedElsewhere(
                        f"{model} is being trained by {held.owner} (last heard from "
                        f"{held.age_s:.0f} s ago).",
                        remedy="Nothing needs to be done. Without --no-wait this command waits "
                        "until that training has ended.",
                    )
                errors.show(
                    f"{model} is being trained by {held.owner}. Waiting until that training ends; "
                    "dr-stop-training or Ctrl-C ends the waiting."
                )
            self.pause(LONG_LOOK_S if lives else POLL_S)

    def _owner(self) -> Lease | None:
        """A training here that has not taken its lease yet counts too."""
        held = live_holder(self.model)
        if held is not None:
            return held
        record = RunRecord.read(self.folder)
        if record is None or not record.alive:
            return None
        if (record.bucket, record.prefix) != (self.model.bucket.name, self.model.prefix):
            return None  # the start refuses it
        return Lease(
            session=record.session,
            host="this machine",
            pid=record.pid,
            renewed=record.started_at,
            machine=this_machine(),
            pid_started=record.pid_started,
        )

    def _is_known_to_live(self, held: Lease) -> bool:
        return held.machine == this_machine() and is_owner_alive(held)
