"""Knows the last and the best checkpoint of a training, for several duties."""

from collections.abc import Callable
from contextlib import suppress

from drcli.base.errors import DrError
from drcli.bucket.bucket import Bucket
from drcli.model.best_checkpoint import read_scores
from drcli.model.model_store import ModelStore
from drcli.records.scores import Score
from drcli.run.periodic import Periodic, within

POLL_S = 20.0
LAST_LOOK_S = 3.0


class CheckpointWatch:
    """Looks every few seconds in a thread."""

    def __init__(self) -> None:
        self._bucket: Bucket | None = None
        self._open: Callable[[], Bucket] | None = None
        self._prefix = ""
        self._thread: Periodic | None = None
        self._has_looked_last = False
        self.last: Score | None = None
        """The newest checkpoint; None before the first look."""
        self.best: Score | None = None
        """The best one, None before the first evaluation."""

    def start(self, open_bucket: Callable[[], Bucket], prefix: str) -> None:
        if self._thread is not None:
            return
        self._open, self._prefix = open_bucket, prefix
        self._thread = Periodic("checkpoint watch", self.look, POLL_S)
        self._thread.start()

    def stop(self) -> None:
        if self._thread is not None:
            self._thread.stop()

    def look(self) -> None:
        if self._open is None:
            return
        if self._bucket is None:
            self._bucket = self._open()
        scores = read_scores(ModelStore(self._bucket, self._prefix))
        if scores is None:
            return
        self.last = scores.last_checkpoint
        if scores.best_checkpoint.avg_eval_metric is not None:
            self.best = scores.best_checkpoint

    def look_last(self, within_s: float = LAST_LOOK_S) -> None:
        """When the workers have exited; one success is enough."""
        if not self._has_looked_last:
            within(min(within_s, LAST_LOOK_S), self._look_last)

    def _look_last(self) -> None:
        with suppress(DrError):
            self.look()
            self._has_looked_last = True
