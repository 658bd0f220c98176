"""Keeps a training's record, and never ends it."""

import secrets
import socket
import time
from dataclasses import replace

from drcli.base import errors
from drcli.base.errors import DrError, OwnershipLost
from drcli.base.log import get_logger
from drcli.model.history import HistoryReader
from drcli.model.model_store import ModelStore
from drcli.model.training_records import (
    read_spending,
    read_training,
    with_end,
    with_spending,
    write_training,
)
from drcli.records.training_record import RunOutcome, StartSpending, TrainingRecord, TrainingStart
from drcli.run.cost import Cost
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import Ending
from drcli.transfer.record_training import (
    NewStart,
    known_training,
    record_start,
    settle,
    training_id,
    with_results,
)

_logger = get_logger(__name__)

UPDATE_S = 300.0
"""A vanishing machine loses so much."""

END_PATIENCE_S = 4.0


class StartRecorder:
    def __init__(self, model: ModelStore) -> None:
        self._model = model
        self._known: TrainingRecord | None = None

    def prepare(self, before: TrainingStart | None, *, resumes: bool) -> str:
        """Complete the record of a training that is deleted or begun anew."""
        try:
            if resumes:
                self._known = known_training(self._model, before)
                return self._known.id
            settle(self._model, gone=True)
        except DrError as error:
            _warn("of the training before", error)
        return training_id(self._model.prefix, before) if resumes else secrets.token_hex(4)

    def record(self, new: NewStart) -> str:
        """The id of the training; empty if nothing could be written."""
        try:
            return record_start(self._model, new, self._known).id
        except DrError as error:
            _warn("of this training", error)
            return ""


class RecordKeeping(Duty):
    name = "training record"

    def __init__(self, run: RunningTraining, cost: Cost) -> None:
        super().__init__(run)
        self.every_s = UPDATE_S if run.job.training else None
        self._cost = cost
        self._record: TrainingRecord | None = None
        self._spent: dict[str, StartSpending] = {}
        self._reader = HistoryReader()

    def finish(self, ending: Ending) -> None:
        if self.thread is None:
            return
        outcome = ending.outcome
        begun = self.run.job.begun or RunOutcome(
            self.run.job.session, socket.gethostname(), 0.0, 0.0
        )
        ended = replace(
            begun,
            state=outcome.state,
            code=outcome.code,
            message=outcome.message,
            ended_at=time.time(),
        )
        patience_s = min(END_PATIENCE_S, ending.left_s(0.2))
        self.thread.finish(lambda: self._write(ended), patience_s, ending.hurried)

    def work(self) -> None:
        """DrError if the bucket refuses."""
        self._write(None)

    def _write(self, ended: RunOutcome | None) -> None:
        bucket, config = self.bucket, self.run.job.config.model
        store = ModelStore(bucket, config.prefix)
        model = ModelStore.of(config, bucket, config.prefix)
        if self._record is None:
            self._record = read_training(store, self.run.job.training)
            if self._record is None:
                return  # somebody has deleted it
            self._spent = read_spending(store)
        record = with_results(self._record, model, self._reader)
        record = with_spending(record, {**self._spent, self.run.job.session: self._own_spending()})
        if ended is not None:
            record = with_end(record, ended)
        write_training(bucket, record)
        self._record = record

    def _own_spending(self) -> StartSpending:
        price = self._cost.spending.usd_per_hour
        usd = self._cost.own_usd
        priced = price is not None or usd > 0.0
        return StartSpending(
            self.run.job.session,
            socket.gethostname(),
            self._cost.own_hours,
            usd if priced else None,
            price,
        )


def _warn(what: str, error: DrError) -> None:
    if isinstance(error, OwnershipLost):
        raise error
    errors.warn(f"The record {what} could not be written: {error} {error.remedy}")
