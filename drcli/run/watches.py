"""What keeps a training alive, or ends it in time."""

import os
from collections.abc import Mapping
from contextlib import suppress

from drcli.base.errors import DrError
from drcli.model.model_store import ModelStore
from drcli.model.training_state import Rollbacks, read_reward_errors, read_rollbacks
from drcli.records.reward import RewardErrorEntry, RewardErrorRecord, sum_of
from drcli.records.stage import StageNote
from drcli.run.duty import Duty, RunningTraining
from drcli.run.interruption_watch import SAVE_S
from drcli.run.outcome import Ending, Outcome, interrupted
from drcli.run.periodic import within

# Tells of failures after which a training goes on: rollbacks, failed reward calls.


POLL_S = 60.0
LAST_LOOK_S = 3.0
TOLD_SHARE = 0.001
"""Of failing reward calls: nothing is learned from these steps."""

ErrorKey = tuple[str, str, int | None]


class FailureWatch(Duty):
    """Tells each rollback and distinct error once in a model's life."""

    name = "failure watch"
    every_s = POLL_S

    def __init__(self, run: RunningTraining) -> None:
        super().__init__(run)
        self._rollbacks = Rollbacks()
        self._records: list[RewardErrorRecord] = []
        self._told_rollbacks = 0
        self._told_errors: set[ErrorKey] = set()
        self._told_share = False

    def start(self) -> None:
        with suppress(DrError):
            model = ModelStore(self.run.bucket, self.run.job.config.model.prefix)
            self._told_rollbacks = read_rollbacks(model).count
            records = read_reward_errors(model)
            self._told_share = sum_of(each.total for each in records).share > TOLD_SHARE
            self._told_errors = {entry.key for record in records for entry in record.total.errors}

    def work(self) -> None:
        model = ModelStore(self.bucket, self.run.job.config.model.prefix)
        self._records = read_reward_errors(model)
        self._rollbacks = read_rollbacks(model)

    def check(self) -> Outcome | None:
        self._tell()
        return None

    def end_facts(self) -> Mapping[str, object]:
        self.stop()
        within(LAST_LOOK_S, self._look_last)
        self._tell()
        facts: dict[str, object] = {}
        if self._rollbacks.count:
            facts["rollbacks"] = self._rollbacks.count
        failed = sum(record.total.failed for record in self._records)
        discarded = sum(record.total.discarded for record in self._records)
        if failed:
            facts["reward_errors"] = failed
        if discarded:
            facts["discarded_episodes"] = discarded
        return facts

    def _look_last(self) -> None:
        with suppress(DrError):
            self.work()

    def _tell(self) -> None:
        for rollback in self._rollbacks.entries[self._told_rollbacks :]:
            self.run.board.tell("recovery", rollback.sentence, **rollback.facts())
        self._told_rollbacks = max(self._told_rollbacks, self._rollbacks.count)
        for record in self._records:
            for entry in record.total.errors:
                if entry.key not in self._told_errors:
                    self._told_errors.add(entry.key)
                    self._tell_error(record.worker, entry)
        counts = sum_of(record.total for record in self._records)
        if counts.share > TOLD_SHARE and not self._told_share:
            self._told_share = True
            most = self.run.job.config.train.reward_max_error_share
            self.run.board.tell(
                "fault",
                f"{counts.failures()} (DR_REWARD_MAX_ERROR_SHARE={most:g} of the last 2,000 calls "
                "ends the training).",
                calls=counts.calls,
                failed=counts.failed,
            )

    def _tell_error(self, worker: int, entry: RewardErrorEntry) -> None:
        broken = entry.kind == "discard"
        what = "declared an episode broken" if broken else "failed, and the training goes on"
        text = f"The reward function {what} (sim-{worker}, iteration {entry.first_iteration}): "
        self.run.board.tell(
            "fault",
            f"{text}{entry.text}.",
            worker=f"sim-{worker}",
            line=entry.line,
            source=entry.source,
            reason=entry.reason,
            params=entry.params,
        )


# Notes the next stage or phase in the journal.


class StageWatch(Duty):
    name = "stages"

    def __init__(self, run: RunningTraining) -> None:
        super().__init__(run)
        self._seen = ""

    def check(self) -> Outcome | None:
        self._look()
        return None

    def finish(self, ending: Ending) -> None:
        self._look()

    def _look(self) -> None:
        note = StageNote.of_session(self.run.job.folder, self.run.job.session)
        if note is None or note.checkpoint == self._seen:
            return
        self._seen = note.checkpoint
        self.run.journal.note("stage", note.text, stage=note.stage, checkpoint=note.checkpoint)


# Interrupts a training when the process that started it has ended.


class ParentWatch(Duty):
    """Ray places a training again when its actor has ended, perhaps elsewhere."""

    name = "parent watch"

    def __init__(self, run: RunningTraining) -> None:
        super().__init__(run)
        self._ends_with = run.job.ends_with

    def check(self) -> Outcome | None:
        if self._ends_with in (0, os.getppid()):
            return None
        self._ends_with = 0
        return interrupted(
            "Interrupted: the process that started the training has ended.", SAVE_S, continues=True
        )
