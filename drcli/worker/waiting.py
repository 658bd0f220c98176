"""How a simulation worker waits for the trainer."""

import json
import time
from collections.abc import Callable

from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.checkpoints import CheckpointStore
from drcli.worker.process import StopRequested

POLL_S = 0.06
"""Pause between two looks for a new checkpoint, seconds."""

QUIET_SHARE = 0.7
"""Share of the time that the last checkpoint took in which nobody looks for the next one: each
look takes processor time from the learner that is waited for."""

LONGEST_NAP_S = 0.25
"""Pause between two looks for a request to leave, seconds."""

FINISHED_EVERY_S = 1.0
"""How often a waiting worker looks whether the training is over."""


class CheckpointWaiter:
    """Waits for checkpoints, and takes as little as it can from whoever computes them."""

    def __init__(
        self,
        bucket: Bucket,
        prefix: str,
        session: str,
        *,
        should_stop: Callable[[], bool],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """Begin.

        Args:
            bucket: Where the checkpoints come.
            prefix: Of the model.
            session: Name of this start of the training.
            should_stop: Asked whether to leave.
            say: Told what is waited for.
            clock: Monotonic seconds, for tests.
            pause: Waits the given seconds, for tests.
        """
        self._bucket = bucket
        self._checkpoints = CheckpointStore(bucket, prefix)
        self._end = keys.finished(prefix)
        self._session = session
        self._should_stop = should_stop
        self._say = say
        self._clock = clock
        self._pause = pause
        self._s_per_step = 0.0

    def wait(
        self, number: int, newest: int, steps: int, since_s: float
    ) -> keys.CheckpointName | None:
        """Wait for a checkpoint of at least this number, or for one from before the last.

        Args:
            number: What is waited for.
            newest: Number of the checkpoint that drove last, -1 before the first.
            steps: Steps driven with it, which the trainer learns from now.
            since_s: When the trainer got them, on the clock.

        Returns:
            Its name, or None when the training is finished.

        Raises:
            StopRequested: When this process was asked to leave.
        """
        looked_for_end = -FINISHED_EVERY_S
        quiet_until = since_s + QUIET_SHARE * self._s_per_step * steps
        while True:
            self._obey()
            name = keys.CheckpointName.parse(self._checkpoints.latest_name() or "")
            found = name is not None and (name.number >= number or name.number < newest)
            if found or self._clock() - looked_for_end > FINISHED_EVERY_S:
                # After the name: a trainer that ends marks the end before its last checkpoint.
                if self._finished():
                    return None
                looked_for_end = self._clock()
            if found:
                if steps:
                    self._s_per_step = (self._clock() - since_s) / steps
                return name
            self._say(f"waits for the trainer (checkpoint {number})")
            self._pause(POLL_S)
            while (left_s := quiet_until - self._clock()) > 0.0:
                self._obey()
                self._pause(min(left_s, LONGEST_NAP_S))

    def _obey(self) -> None:
        if self._should_stop():
            raise StopRequested

    def _finished(self) -> bool:
        try:
            mark = json.loads(self._bucket.get(self._end))
        except ObjectMissing:
            return False
        return bool(mark["session"] == self._session)
