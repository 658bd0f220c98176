"""Waits in a simulation worker for the trainer's next checkpoint."""

import math
import time
from collections import deque
from collections.abc import Callable

from drcli.base.log import get_logger
from drcli.bucket.bucket import ObjectDamaged, readable_record
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_rollbacks
from drcli.records.checkpoint import CheckpointName, CheckpointRecord, checkpoint_name
from drcli.records.rollout import Manifest
from drcli.records.run_record import TrainingEnd
from drcli.train.rollouts import find_manifest
from drcli.workers.worker_process import StopRequested

_logger = get_logger(__name__)

POLL_S, WOKEN_POLL_S = 0.06, 0.25
"""In any case, and for a worker that the trainer wakes."""

FRUGAL_SHARE, LONGEST_POLL_S = 0.03, 1.0
"""If looks cost money: of the time since the rollouts were delivered; a checkpoint is noticed 3 %
late at most.
"""

QUIET_SHARE = 0.7
"""Of the learning time: each look takes processor time from the learner."""

REMEMBERED = 5
"""Learning times. The shortest counts: something may have delayed the others."""

LONGEST_PAUSE_S = 0.25
FINISHED_EVERY_S = 1.0
RECHECK_S = 10.0
"""Whether its rollouts are still there; else trainer and worker could wait forever."""


class CheckpointWaiter:
    """Waits with little processor time, which the trainer needs."""

    def __init__(
        self,
        model: ModelStore,
        session: str,
        worker: int,
        workers: int = 1,
        *,
        lag: int = 1,
        frugal: bool = False,
        should_stop: Callable[[], bool],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], bool | None] = time.sleep,
        poll_s: float = POLL_S,
        is_reassigned: Callable[[CheckpointName], bool] | None = None,
    ) -> None:
        """`pause` returns True if woken early.

        `lag`: how many iterations driving may be ahead. `frugal`: the bucket is not on this
        machine.
        """
        self._model = model
        self._worker = worker
        self._checkpoints = CheckpointStore(model)
        self._end = keys.finished(model.prefix)
        self._session = session
        self._should_stop = should_stop
        self._say = say
        self._clock = clock
        self._pause = pause
        self._shortest_s = poll_s
        self._workers = workers
        self._lag = lag
        self._is_reassigned = is_reassigned
        self._frugal = frugal
        self._learn_s_per_step: deque[float] = deque(maxlen=REMEMBERED)

    def learn_from(self, record: CheckpointRecord) -> None:
        """Remember how long the trainer learned.

        The worker's own waiting time contains its pauses.
        """
        learned = record.counters.learned
        if learned is not None and learned.steps and not math.isnan(learned.learn_s):
            self._learn_s_per_step.append(learned.learn_s / learned.steps)

    def _quiet_s(self, steps: int) -> float:
        if len(self._learn_s_per_step) < 2 or self._lag > 1:  # the trainer may be just done then
            return 0.0
        return QUIET_SHARE * min(self._learn_s_per_step) * steps * self._workers

    def wait(self, number: int, newest: int, steps: int, since_s: float) -> CheckpointName | None:
        """Wait for a checkpoint of at least this number, or one before the newest.

        If rollouts of the newest are lost, it is returned once more, so that its iteration is
        driven again. `newest` is -1 before the first; `since_s` is when `steps` were delivered.

        Returns:
            None when the training has ended.

        Raises:
            StopRequested: `should_stop` returned True.
        """
        looked_for_end = -FINISHED_EVERY_S
        rechecked = self._clock()
        quiet_until = since_s + self._quiet_s(steps)
        while True:
            self._check_stop()
            name = self._checkpoints.pointed()
            found = name is not None and (name.number >= number or name.number < newest)
            if found or self._clock() - looked_for_end > FINISHED_EVERY_S:
                # After the name, because a trainer marks the end before its last checkpoint.
                if self._finished():
                    return None
                looked_for_end = self._clock()
            if found:
                return name
            if name is not None and not steps and self._is_reassigned and self._is_reassigned(name):
                return name
            if name is not None and steps and self._clock() - rechecked > RECHECK_S:
                if self._is_lost(name):
                    _logger.warning(
                        "The rollouts of iteration %d are lost; driving it again.", name.number
                    )
                    return name
                rechecked = self._clock()
            self._say(f"waits for the trainer (checkpoint {number})")
            woken = self._pause(self._poll_s(since_s))
            while not woken and (left_s := quiet_until - self._clock()) > 0.0:
                self._check_stop()
                woken = self._pause(min(left_s, LONGEST_PAUSE_S))

    def _poll_s(self, since_s: float) -> float:
        if not self._frugal:
            return self._shortest_s
        waited_s = self._clock() - since_s
        return min(max(self._shortest_s, FRUGAL_SHARE * waited_s), LONGEST_POLL_S)

    def _is_lost(self, newest: CheckpointName) -> bool:
        manifest = find_manifest(self._model, newest.number, self._worker)
        if (
            manifest is not None
            and manifest.is_of(self._session)
            and manifest.checkpoint
            in self._checkpoints.behaviour_checkpoints(newest, newest.number - self._lag)
            and self._counts(manifest)
        ):
            return False
        # A trainer that has just learned from them, or ended, may have deleted them.
        return self._checkpoints.pointed() == newest and not self._finished()

    def _counts(self, manifest: Manifest) -> bool:
        """The trainer has not given up the weights that drove."""
        try:
            rollbacks = read_rollbacks(self._model)
        except ObjectDamaged:
            return True
        number = checkpoint_name(manifest.checkpoint).number
        return rollbacks.allows(number, manifest.rollbacks)

    def _check_stop(self) -> None:
        if self._should_stop():
            raise StopRequested

    def _finished(self) -> bool:
        # The supervisor ends the workers too.
        end = readable_record(self._model.bucket, self._end, TrainingEnd.decode)
        return end is not None and end.session == self._session
