"""Publishes the checkpoints of a trainer, partly in a thread."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import ParamSpec

from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from drcli.base.errors import StorageError, TrainingFailed
from drcli.base.log import get_logger, plain
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.convert.build_network import has_own_critic, load_weights
from drcli.convert.frozen_graph import encode_policy
from drcli.convert.imported_policy import CRITIC_WARMUP
from drcli.learn.algorithms import Algorithm
from drcli.learn.learner import Learner
from drcli.learn.policy import PolicySpec
from drcli.learn.taught import TaughtLearner
from drcli.learn.update_result import NonFiniteLossError
from drcli.model import keys
from drcli.model.best_checkpoint import evaluated_numbers, read_scores
from drcli.model.checkpoints import Checkpoint, CheckpointStore, checkpoint_objects
from drcli.model.history import SMOOTH
from drcli.model.model_store import ModelStore
from drcli.model.traces import TraceRetention
from drcli.model.training_state import (
    RATE_FACTOR,
    Reason,
    Rollback,
    Rollbacks,
    read_rollbacks,
    write_rollbacks,
)
from drcli.records.checkpoint import CheckpointName, Counters, checkpoint_name
from drcli.records.job import Job
from drcli.records.trace import STEP_S

_logger = get_logger(__name__)

P = ParamSpec("P")


class CheckpointPublisher:
    """Publishes weights at once, then the graph while workers already drive.

    If the bucket is on this machine (`near`), the optimizer state comes with the weights, so
    that a power cut leaves both or neither; otherwise it follows. With the `sensors` of its model,
    a checkpoint gets the frozen graph, which the physical car loads.
    """

    def __init__(
        self,
        checkpoints: CheckpointStore,
        traces: TraceRetention,
        is_ending: Callable[[], bool],
        on_weights: Callable[[], None] = lambda: None,
        *,
        near: bool = False,
        sensors: Sequence[str] = (),
    ) -> None:
        self._checkpoints = checkpoints
        self._sensors = sensors
        self._traces = traces
        self._is_ending = is_ending
        self._on_weights = on_weights
        self._near = near
        self._uploader = ThreadPoolExecutor(1, thread_name_prefix="upload")
        self._uploads: list[Future[object]] = []

    def publish(self, name: CheckpointName, learner: Learner, counters: Counters) -> None:
        """Publish weights, once the checkpoint before is uploaded.

        A process that is ending publishes them with the optimizer state or not at all.

        Raises:
            StorageError: These weights, or the checkpoint before, did not arrive.
        """
        self.join()
        tensors = learner.optimizer.tensors()
        at_once = self._near or self._is_ending()
        moments = save_tensors(tensors) if tensors and at_once else None
        state = {name: t.contiguous() for name, t in learner.model.state_dict().items()}
        weights = save_tensors(state)
        record = self._checkpoints.save(
            name.number,
            name.steps,
            weights,
            optimizer=moments,
            sim_time_s=round(name.steps * STEP_S, 3),
            counters=counters,
            on_pointed=self._on_weights,
        )
        plain.info("Checkpoint> Saving in path=['%s']", record.name)
        if moments is not None:
            self.submit(self._checkpoints.forget_older_states, record.name)
        elif tensors:
            self.submit(self._checkpoints.attach_optimizer, record, save_tensors(tensors))
        if self._sensors:
            spec = learner.model.spec
            self.submit(write_graph, self._checkpoints, name.number, weights, spec, self._sensors)
        self.submit(self._thin_traces, name.number)

    def submit(self, task: Callable[P, object], *arguments: P.args, **named: P.kwargs) -> None:
        self._uploads.append(self._uploader.submit(task, *arguments, **named))

    def join(self) -> None:
        """Raises the error of an upload."""
        while self._uploads:
            self._uploads.pop(0).result()

    def close(self) -> None:
        self._uploader.shutdown()

    def _thin_traces(self, newest: int) -> None:
        try:
            thinned = self._traces.apply(newest)
        except StorageError as error:
            _logger.warning("Old traces were not deleted: %s", error)
            return
        if thinned is not None:
            _logger.info(
                "Deleted the traces of %d older iterations (%.1f MB); %d iterations have traces. "
                "DR_TRAIN_TRACES_MAX_MB=0 keeps all.",
                thinned.iterations,
                thinned.size_bytes / 1e6,
                thinned.left,
            )


def write_graph(
    store: CheckpointStore, number: int, weights: bytes, spec: PolicySpec, sensors: Sequence[str]
) -> None:
    """From the file of the weights, so it can work while the trainer changes them."""
    arrays = {name: tensor.float().numpy() for name, tensor in load_tensors(weights).items()}
    store.attach_graph(number, encode_policy(arrays, spec, sensors))


# Restores a trainer from a checkpoint: weights, optimizer, invalid results.


def restore_learner(learner: Learner, found: Checkpoint) -> None:
    """With the progress of a new critic."""
    load_weights(learner.model, found.tensors, found.record.name)
    if found.optimizer is None:
        _logger.warning("The optimizer starts over: the checkpoint has no state of it.")
    else:
        restore_optimizer(learner, found.optimizer)
    learner.critic_warmup = found.record.counters.critic_warmup or 0
    if has_own_critic(learner.model, found.tensors) and not isinstance(learner, TaughtLearner):
        learner.critic_warmup = CRITIC_WARMUP


def restore_optimizer(learner: Learner, state: bytes) -> None:
    """A safetensors file, if it fits; weights can do without it."""
    try:
        learner.optimizer.restore(load_tensors(state))
    except ValueError as error:
        _logger.warning("The optimizer starts over: its saved state does not fit: %s", error)


def forget_evaluations(model: ModelStore, *, newest: int) -> None:
    """Delete results of checkpoints that do not exist, as seen from the newest.

    Later ones would count for new checkpoints of their numbers.
    """
    known = {name.number for name in checkpoint_objects(model).values()}
    numbers = [n for n in evaluated_numbers(model) if n > newest or n not in known]
    if numbers:
        model.bucket.delete([keys.evaluation_result(model.prefix, number) for number in numbers])


# Lets a trainer go back to its last good checkpoint; it may be killed at any point.
#
# The decision is one write (`Rollbacks`). The rest is what a trainer does when it starts.


LOOK_BACK = 3


class RolledBack(Exception):
    """Begin again from the bucket."""


class RollbackControl:
    def __init__(self, model: ModelStore, job: Job, checkpoints: CheckpointStore) -> None:
        self._model = model
        self._job = job
        self._checkpoints = checkpoints
        try:
            self.known = read_rollbacks(model)
        except ObjectDamaged as error:
            _logger.warning("%s The training goes on as if there had been none.", error)
            self.known = Rollbacks()

    @property
    def left(self) -> int:
        return max(0, self._job.config.train.train_max_rollbacks - self.known.count)

    def load_latest(self) -> Checkpoint | None:
        """With its optimizer; None if the model has none.

        Raises:
            StorageError: All checkpoints are damaged.
        """
        found = self._checkpoints.load_latest(with_optimizer=True)
        target = None if found is None else self.known.pending(found.record)
        if target is None:
            return found
        older = self._checkpoints.load_latest(with_optimizer=True, newest=target)
        if older is None:
            _logger.warning("Checkpoint %d is lost; the training cannot go back.", target.number)
        return older or found

    def mark(self, found: Checkpoint) -> None:
        """Note in the checkpoint how often the training went back."""
        counters = found.record.counters
        if (counters.rollbacks or 0) < self.known.count:
            counters = replace(counters, rollbacks=self.known.count)
            self._checkpoints.rewrite(replace(found.record, counters=counters))

    def decide(
        self,
        reason: Reason,
        text: str,
        newest: CheckpointName,
        lr: float,
        elapsed_s: float,
        *,
        first: int = 0,
    ) -> Rollback | None:
        """Go back, if that is allowed and there is a good checkpoint.

        `first` is the oldest one to go back to, the first of a stage.

        Returns:
            What is stored now; None if the training does not go back.
        """
        target = self._target(reason, newest, first) if self.left else None
        if target is None:
            return None
        rollback = Rollback(
            at=time.time(),
            reason=reason,
            text=text,
            left=str(newest),
            target=str(target),
            lr=lr,
            factor=self.known.factor(lr) * RATE_FACTOR,
            elapsed_s=elapsed_s,
            session=self._job.session,
        )
        self.known = Rollbacks([*self.known.entries, rollback])
        write_rollbacks(self._model, self.known)
        return rollback

    def nan_failure(
        self, error: NonFiniteLossError, iteration: int, algorithm: Algorithm
    ) -> TrainingFailed:
        clips = algorithm.reads("max_grad_norm")
        shorter = ", or set `max_grad_norm` to 0.5," if clips else ""
        remedy = (
            f"Lower `lr` to a third{shorter} in hyperparameters.json, then "
            "continue with `dr-start-training --resume`. DR_TRAIN_MAX_ROLLBACKS=2 does it "
            "without you."
        )
        best = CheckpointName.parse(self._checkpoints.best_name() or "")
        if best is not None:
            remedy += f" Or start a new model from checkpoint {best.number}, the best, with "
            remedy += "DR_LOCAL_S3_PRETRAINED=True."
        return TrainingFailed(
            "NaN detected in loss function, aborting training. "
            f"Iteration {iteration}: {error} "
            "The weights from before this iteration are kept as the last checkpoint.",
            remedy=remedy,
        )

    def _target(self, reason: Reason, newest: CheckpointName, first: int) -> CheckpointName | None:
        """After a collapse, the best checkpoint.

        A NaN announces itself a few updates before, so the oldest of the newest is taken, but
        none before the best one.
        """
        best = self._best()
        if best is not None and best.number < first:
            best = None  # of another stage
        if reason == "collapse":
            # What was so good just now has not collapsed.
            old_enough = best is not None and best.number <= newest.number - SMOOTH
            return best if best is not None and old_enough and self._is_intact(best) else None
        names = sorted(set(checkpoint_objects(self._model).values()))
        oldest = best.number if best is not None else first
        candidates = [name for name in names if oldest <= name.number <= newest.number]
        recent = candidates[-LOOK_BACK:]
        return next((name for name in recent if self._is_intact(name)), None)

    def _best(self) -> CheckpointName | None:
        try:
            scores = read_scores(self._model)
        except ObjectDamaged:
            return None
        if scores is None or scores.best_checkpoint.avg_eval_metric is None:
            return None
        return checkpoint_name(scores.best_checkpoint.name)

    def _is_intact(self, name: CheckpointName) -> bool:
        try:
            self._checkpoints.load(str(name))
        except (ObjectMissing, ObjectDamaged):
            return False
        return True
