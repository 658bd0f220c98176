"""Knows the last and the best checkpoint of a training, for several duties."""

from contextlib import suppress

from drcli.base.errors import DrError
from drcli.model.best_checkpoint import read_scores
from drcli.model.model_store import ModelStore
from drcli.records.scores import Score
from drcli.run.duty import Duty, RunningTraining
from drcli.run.periodic import within

POLL_S = 20.0
LAST_LOOK_S = 3.0


class CheckpointWatch(Duty):
    """Looks every few seconds, if another duty needs it."""

    name = "checkpoint watch"

    def __init__(self, run: RunningTraining) -> None:
        super().__init__(run)
        self._has_looked_last = False
        self.last: Score | None = None
        """The newest checkpoint; None before the first look."""
        self.best: Score | None = None
        """The best one, None before the first evaluation."""

    def turn_on(self) -> None:
        self.every_s = POLL_S

    def work(self) -> None:
        scores = read_scores(ModelStore(self.bucket, self.run.job.config.model.prefix))
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
            self.work()
            self._has_looked_last = True
