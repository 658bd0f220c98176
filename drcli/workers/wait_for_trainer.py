"""Waits in a simulation worker for the trainer's next checkpoint."""

import math
import time
from collections import deque
from collections.abc import Callable

from drcli.base.json_record import RecordError
from drcli.base.log import get_logger
from drcli.exchange.checkpoint import CheckpointName, CheckpointRecord, checkpoint_name
from drcli.exchange.rollout_manifest import Manifest
from drcli.exchange.run_state import TrainingEnd
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.checkpoints import CheckpointStore
from drcli.store.rollbacks import read_rollbacks
from drcli.store.rollout_reader import find_manifest
from drcli.workers.worker_process import StopRequested

_logger = get_logger(__name__)

POLL_S, WOKEN_POLL_S = 0.06, 0.25
"""Pause between two looks for a new checkpoint: in any case, and for a worker that the trainer
wakes."""

FRUGAL_SHARE, LONGEST_POLL_S = 0.03, 1.0
"""The pause if each look costs money: this share of the time since the rollouts were delivered, so
that a checkpoint is noticed 3 % late at most, but not longer than this."""

QUIET_SHARE = 0.7
"""Share of the learning time in which the worker does not look for the next checkpoint: each look
takes processor time from the learner."""

REMEMBERED = 5
"""How many learning times are remembered. The shortest one counts, because something that is over
may have delayed the others."""

LONGEST_PAUSE_S = 0.25
"""Longest pause between two looks for a request to stop."""

FINISHED_EVERY_S = 1.0
"""How often a waiting worker checks whether the training has ended."""

RECHECK_S = 10.0
"""How often a waiting worker checks that its rollouts are still in the bucket. Otherwise trainer
and worker could wait for each other forever."""


class CheckpointWaiter:
    """Waits for checkpoints with little processor time, which the trainer needs."""

    def __init__(
        self,
        bucket: Bucket,
        prefix: str,
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
        """Begin.

        `session` names this start of the training, and `say` publishes what the worker waits for.
        `lag` is by how many iterations driving may be ahead of learning.
        `frugal` is for a bucket that is not on this machine: it is asked less often. `pause` waits,
        usually for `poll_s`, and returns True if it was ended early because there may be a new
        checkpoint. `is_reassigned` says whether the worker, which had nothing to drive with this
        checkpoint, now has. `clock` (monotonic seconds) is for tests.
        """
        self._bucket = bucket
        self._prefix = prefix
        self._worker = worker
        self._checkpoints = CheckpointStore(bucket, prefix)
        self._end = keys.finished(prefix)
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
        """Remember how long the trainer learned to make a checkpoint.

        The worker's own waiting time would not do, because it contains the worker's pauses.
        """
        learned = record.counters.learned
        if learned is not None and learned.steps and not math.isnan(learned.learn_s):
            self._learn_s_per_step.append(learned.learn_s / learned.steps)

    def _quiet_s(self, steps: int) -> float:
        """How long not to look for a checkpoint made from this many steps of this worker."""
        if len(self._learn_s_per_step) < 2 or self._lag > 1:  # the trainer may be just done then
            return 0.0
        return QUIET_SHARE * min(self._learn_s_per_step) * steps * self._workers

    def wait(self, number: int, newest: int, steps: int, since_s: float) -> CheckpointName | None:
        """Wait for a checkpoint of at least this number, or for one before the newest.

        If rollouts of the newest checkpoint are lost, it is returned once more, so that the worker
        drives that iteration again.

        Args:
            number: Least number.
            newest: Number of the checkpoint that drove last, -1 before the first.
            steps: Steps driven with it, from which the trainer learns now; 0 if it had nothing to
                drive.
            since_s: When they were delivered, on the clock.

        Returns:
            The checkpoint, or None when the training has ended.

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
        """Pause before the next look, for rollouts that were delivered at this time."""
        if not self._frugal:
            return self._shortest_s
        waited_s = self._clock() - since_s
        return min(max(self._shortest_s, FRUGAL_SHARE * waited_s), LONGEST_POLL_S)

    def _is_lost(self, newest: CheckpointName) -> bool:
        """Whether the rollouts that this worker delivered for an iteration are lost."""
        manifest = find_manifest(self._bucket, self._prefix, newest.number, self._worker)
        if (
            manifest is not None
            and manifest.is_of(self._session)
            and manifest.checkpoint in self._checkpoints.drivers(newest, newest.number - self._lag)
            and self._counts(manifest)
        ):
            return False
        # A trainer that has just learned from them, or ended, may have deleted them.
        return self._checkpoints.pointed() == newest and not self._finished()

    def _counts(self, manifest: Manifest) -> bool:
        """Whether the trainer has not given up the weights that drove."""
        try:
            rollbacks = read_rollbacks(self._bucket, self._prefix)
        except ObjectDamaged:
            return True
        number = checkpoint_name(manifest.checkpoint).number
        return rollbacks.allows(number, manifest.rollbacks)

    def _check_stop(self) -> None:
        if self._should_stop():
            raise StopRequested

    def _finished(self) -> bool:
        try:
            end = TrainingEnd.decode(self._bucket.get(self._end))
        except (ObjectMissing, RecordError):  # the supervisor ends the workers too
            return False
        return end.session == self._session
