"""Reads evaluations for the trainer, and keeps the best checkpoint up to date.

`drcli.model.best_checkpoint` decides which one is better.
"""

from collections.abc import Callable, Iterable

from drcli.base.clock import wait_until
from drcli.base.log import get_logger, plain
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.model import keys
from drcli.model.best_checkpoint import read_evaluation
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.model.repair import set_aside
from drcli.model.training_state import NO_ROLLBACKS, Rollbacks
from drcli.records.checkpoint import CheckpointName, checkpoint_name
from drcli.records.iteration import IterationRecord
from drcli.records.scores import EvaluationResult, JudgedWorld
from drcli.train.goals import Target

_logger = get_logger(__name__)

REMEMBERED_SCORES = 2
"""Besides iterations that driving may be ahead."""

LAST_EVALUATION_S = 10.0


class Scoring:
    """The evaluations of a model that are still expected.

    Scores are compared by `metric` on the track of DR_TRAIN_BEST_MODEL_WORLD. A checkpoint that
    reaches one of the `targets` is the best. With `second`, DR_TRAIN_EVAL_WORLD is driven too.
    Checkpoints given up in `rollbacks` do not count.
    """

    def __init__(
        self,
        model: ModelStore,
        checkpoints: CheckpointStore,
        history: History,
        metric: str,
        world: JudgedWorld = "training",
        *,
        second: bool = False,
        targets: Callable[[], Iterable[Target]] = lambda: (),
        rollbacks: Rollbacks = NO_ROLLBACKS,
        lag: int = 1,
    ) -> None:
        self._remembered = REMEMBERED_SCORES + max(1, lag)
        self._rollbacks = rollbacks
        self._model = model
        self._checkpoints = checkpoints
        self._history = history
        self._metric = metric
        self._world = world
        self._second = second
        self._targets = targets
        self._since = 0
        self._expected: set[int] = set()
        self._ahead: int | None = None

    def begin_stage(self, first: int) -> None:
        """Checkpoints before `first` drove another track, or for another reward."""
        self._since = first
        self._checkpoints.begin_stage(first)

    def begin_track(self, first: int) -> None:
        """From this checkpoint on, laps cannot be compared with earlier ones.

        The best checkpoint stays until another one is evaluated. A start with other settings
        has forgotten its score already; a changed stage is noticed here.
        """
        judged = self._world != "evaluation"
        self._checkpoints.begin_track(first, judged=judged)
        if judged:
            self._since = first

    def restore(self, records: Iterable[IterationRecord]) -> None:
        newest = list(records)[-self._remembered :]
        self._expected = {r.iteration for r in newest if not r.evaluation_progress}

    def expect(self, iteration: int, evaluates: int | None) -> None:
        if evaluates is not None:
            self._expected.add(evaluates)
        if self._ahead == iteration:
            self._expected.add(iteration)  # the history has a record for its evaluation now
        self._expected = {n for n in self._expected if n > iteration - self._remembered}

    def score(self, newest: CheckpointName, *, last: bool = False) -> None:
        """Score the checkpoints whose evaluations have arrived.

        At the `last` time, and when it is late, an incomplete evaluation counts.
        """
        for iteration in sorted(self._expected):
            result = self._result(iteration)
            late = last or iteration <= newest.number - self._remembered
            if result is not None and (late or self._is_complete(result)):
                # A worker may still drive the rest after its trainer has started again.
                if self._is_complete(result) or not last:
                    self._expected.discard(iteration)
                self._history.add_evaluation(iteration, result)
                driven = result.on("training")
                _logger.info(
                    "Checkpoint %d: %s, mean progress %.1f %%.",
                    iteration,
                    driven.laps,
                    driven.mean_progress,
                )
                self._compare(result, newest)

    def score_all(self, newest: CheckpointName) -> None:
        """Score the newest checkpoint too, before its iteration is learned from.

        Done when a trainer starts and ends, so that no evaluation is lost.
        """
        self.score(newest, last=True)
        result = self._result(newest.number)
        if result is not None and result.checkpoint == str(newest):
            self._ahead = newest.number
            self._compare(result, newest)

    def wait(self, evaluates: int, patience_s: float, should_stop: Callable[[], bool]) -> None:
        """About as long as the iteration took: a worker that died sends none."""
        self._expected.add(evaluates)
        key = keys.evaluation_result(self._model.prefix, evaluates)

        def arrived() -> bool:
            if not self._model.bucket.exists(key):
                return False
            result = self._result(evaluates)
            return result is None or self._is_complete(result)

        wait_until(
            lambda: should_stop() or arrived(),
            # A confirmation is up to twice as long, and there may be a second track.
            patience_s=max(LAST_EVALUATION_S, patience_s) * (4.0 if self._second else 3.0),
            first_s=0.1,
        )

    def _is_complete(self, result: EvaluationResult) -> bool:
        return not result.confirms and (result.second is not None or not self._second)

    def _result(self, iteration: int) -> EvaluationResult | None:
        """Not that of a given-up checkpoint with the same number."""
        try:
            found = read_evaluation(self._model, iteration)
            return found if self._rollbacks.allows(iteration, found.rollbacks) else None
        except ObjectMissing:
            return None
        except ObjectDamaged as error:
            self._expected.discard(iteration)
            key = keys.evaluation_result(self._model.prefix, iteration)
            kept = set_aside(self._model, key, self._model.bucket.get(key))
            self._model.bucket.delete([key])
            _logger.warning("%s It is not scored; the damaged one is kept as %s.", error, kept)
            return None

    def _compare(self, result: EvaluationResult, newest: CheckpointName) -> None:
        if checkpoint_name(result.checkpoint).number < self._since:
            return
        again = result.confirmation
        reaches_goal = again is not None and any(
            target.shown_by(result.progress, result.lap_s)
            and target.confirmed_by(again.progress, again.lap_s)
            for target in self._targets()
        )
        self._checkpoints.record_evaluation(
            result, self._metric, self._world, reaches_goal=reaches_goal
        )
        best = CheckpointName.parse(self._checkpoints.best_name() or "")
        if best is not None:
            plain.info(
                "Best checkpoint number: %d, Last checkpoint number: %d", best.number, newest.number
            )
