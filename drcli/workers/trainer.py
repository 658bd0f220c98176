"""The trainer worker: learns from each iteration's rollouts and publishes the next checkpoint.

Run by the supervisor as `python -m drcli.workers.trainer`.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import ParamSpec

import torch
from safetensors.torch import save as save_tensors

from drcli.base.errors import StorageError, TrainingFailed
from drcli.base.log import get_logger, plain
from drcli.exchange.checkpoint import CheckpointName, Counters
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.job import Job, WorkerExit
from drcli.exchange.rollback_record import Reason
from drcli.exchange.run_state import TrainingEnd
from drcli.exchange.stage_note import StageNote
from drcli.formats.build_network import load_weights
from drcli.learn.compute import choose_compute, flush_denormals
from drcli.learn.update_result import NonFiniteLossError, UpdateInterruptedError
from drcli.modelfiles.network_shape import Design
from drcli.store import keys
from drcli.store.alarms import trends
from drcli.store.checkpoint_retention import KeepRules
from drcli.store.checkpoints import CheckpointStore
from drcli.store.history import History
from drcli.store.repair import Model, repair
from drcli.store.rollout_reader import RolloutReader
from drcli.store.trace_retention import TraceRetention
from drcli.workers import reference_log, worker_process
from drcli.workers.build_learner import Learner, build_learner
from drcli.workers.collect_rollouts import Collected, Collector
from drcli.workers.cores import learning_threads, overlaps
from drcli.workers.goals import Goals
from drcli.workers.learner_metrics import LearnerMetrics, line_of, row_of
from drcli.workers.restore_learner import forget_evaluations, restore_optimizer
from drcli.workers.roll_back import RollbackControl, RolledBack
from drcli.workers.scoring import Scoring
from drcli.workers.stage_progress import Counted, StageProgress
from drcli.workers.wait_for_trainer import RECHECK_S
from drcli.workers.worker_process import Activity, Lifeline, StopRequested
from drcli.workers.write_graph import GraphWriter

_logger = get_logger(__name__)

P = ParamSpec("P")

SEED_STRIDE = 1_000_003
"""Keeps the random numbers of iterations apart."""


class Trainer:
    """Learns from its first checkpoint to the end of the training."""

    def __init__(self, job: Job, lifeline: Lifeline, goals: Goals | None = None) -> None:
        """Prepare; with the `goals` of a trainer of this process that has gone back."""
        train, model = job.config.train, job.config.model
        self._job = job
        self._lifeline = lifeline
        self._prefix = model.prefix
        self._bucket = worker_process.open_own_bucket(job, lifeline)
        self._activity = Activity(self._bucket, self._prefix, "trainer", lifeline.pulse)
        self._activity.say("starting")
        own = Model(self._bucket, self._prefix, model.metrics_prefix, model.metric, ())
        for sentence in repair(own):
            _logger.warning(sentence)
        rules = KeepRules(
            train.train_keep_milestones, train.train_keep_every, train.train_keep_max_mb * 1_000_000
        )
        self._checkpoints = CheckpointStore(self._bucket, self._prefix, rules)
        self._history = History(self._bucket, self._prefix)
        self._metrics = LearnerMetrics(self._bucket, self._prefix)
        design = Design.of_model(self._bucket, self._prefix)
        metadata, parameters = design.metadata, design.parameters
        # Each checkpoint carries these files: without them, the model could not be continued.
        self._inputs = {name: data.decode("utf-8-sig") for name, data in design.files.items()}
        self._design = design
        self._rollbacks = RollbackControl(self._bucket, job, self._checkpoints)
        self._found = self._rollbacks.load_latest()
        counters = Counters() if self._found is None else self._found.record.counters
        self._newest = CheckpointName(0, 0)
        if self._found is not None:
            self._newest = CheckpointName(self._found.record.number, self._found.record.steps)
        self._episodes = counters.episodes
        self._elapsed_before_s = max(counters.elapsed_s, self._rollbacks.known.elapsed_s)
        self._started = self._cycle_began = self._rechecked = time.monotonic()
        self._stages = StageProgress(job.stages, counters.stage, self._counted())
        torch.manual_seed(job.seed)
        self._learner = self._build_learner(counters.number_format)
        self._scoring = Scoring(
            self._bucket,
            self._prefix,
            self._checkpoints,
            self._history,
            model.metric,
            train.train_best_model_world if train.train_eval_world else "training",
            second=bool(train.train_eval_world),
            rollbacks=self._rollbacks.known,
        )
        self._graphs = GraphWriter(
            self._checkpoints,
            self._learner.model.spec,
            metadata,
            enabled=train.train_frozen_graph,
        )
        self.goals = goals or Goals(job, parameters, before_s=self._elapsed_before_s)
        frugal = job.config.storage.cloud != "local"
        self._reader = RolloutReader(
            self._bucket,
            self._prefix,
            job.session,
            frugal=frugal,
            rollbacks=self._rollbacks.known,
        )
        self._collector = Collector(
            self._reader, train.workers, train.train_max_steps_per_iteration
        )
        self._traces = TraceRetention(
            self._bucket, self._prefix, train.workers, train.train_traces_max_mb << 20
        )
        self._collapsed = False
        self._alarmed: set[str] = set()
        self._is_short_of_gpu_memory = False
        self._uploader = ThreadPoolExecutor(1, thread_name_prefix="upload")
        self._uploads: list[Future[object]] = []

    def _build_learner(self, number_format: str | None) -> Learner:
        """The learner of the present stage, with fresh weights; it keeps the number format."""
        metadata, algorithm = self._design.metadata, self._design.metadata.training_algorithm
        parameters = self._stages.parameters(self._design.parameters)
        plain.info("Using the following hyper-parameters")
        plain.info(parameters.canonical_json(algorithm))
        train = self._job.config.train
        compute = choose_compute(
            train.torch_precision,
            parameters.batch_size,
            learning_threads(train),
            before=number_format,
        )
        _logger.info("Learning in %s", compute.reason)
        learner = build_learner(metadata, parameters, compute)
        learner.lr_factor = self._rollbacks.known.factor(learner.config.lr)
        if learner.lr_factor != 1.0:
            rate = learner.lr_factor * learner.config.lr
            times = "1 rollback" if self._rollbacks.known.count == 1 else "the rollbacks"
            _logger.info("The learning rate is %.3g since %s.", rate, times)
        return learner

    def run(self) -> None:
        """Learn until there is a reason to end, and score the evaluations that have arrived."""
        try:
            self._train()
        except (StopRequested, TrainingFailed):
            try:
                self._scoring.score_all(self._newest)
            except StorageError as error:
                _logger.warning("The last evaluation is not scored yet: %s", error)
            self._finish_files()
            raise
        except RolledBack:
            self._reader.close()
            self._finish_files()
            raise

    def _train(self) -> None:
        self._restore()
        while (reason := self._reached()) is None:
            self._rechecked = time.monotonic()
            drivers = self._checkpoints.drivers(self._newest)
            if self._stages.first_iteration == self._newest.number:
                drivers = [str(self._newest)]  # the one before belongs to another stage
            collected = self._collector.collect(self._newest.number, drivers, self._is_wait_over)
            if self._lifeline.should_stop():
                raise StopRequested
            if collected is not None:
                over = self._stage_over(collected)
                if over is None:
                    self._learn(collected)
                else:
                    self._begin_next_stage(collected, over)
                collected = None  # frees the memory of its frames
                self._forget_rollouts(before=self._newest.number - 1)
        self._finish(reason)

    def _restore(self) -> None:
        """Continue from the newest intact checkpoint, or publish the first one."""
        found, self._found = self._found, None
        if found is None:
            self._publish()
            return
        for damage in found.damaged:
            _logger.warning("Skipped a damaged checkpoint: %s", damage)
        record = found.record
        forget_evaluations(self._bucket, self._prefix, newest=record.number)
        load_weights(self._learner.model, found.tensors, found.record.name)
        if found.optimizer is None:
            _logger.warning("The optimizer starts over: the checkpoint has no state of it.")
        else:
            restore_optimizer(self._learner, found.optimizer)
        self._learner.critic_warmup = record.counters.critic_warmup or 0
        self._scoring.begin_stage(self._stages.first_iteration)
        self._history.restore(record.number, record.counters.learned)
        self._scoring.restore(self._history.records)
        self._checkpoints.restore_milestones(self._newest, self._history.records)
        problem = self._metrics.restore(self._history.records)
        if problem is not None:
            _logger.warning(problem)
        self._rollbacks.mark(found)
        self._checkpoints.point_to(record)
        if self._rollbacks.known.count:
            self._checkpoints.drop_newer(self._newest)
            self._traces.delete_after(record.number + int(overlaps(self._job.config.train)))
        lost = self._checkpoints.forget_damaged_best()
        if lost is not None:
            _logger.warning(
                "The best checkpoint is lost: %s Evaluations will choose another.", lost
            )
        plain.info("Checkpoint> Restoring from path=%s", record.name)
        self._scoring.score_all(self._newest)
        self._recall()

    def _recall(self) -> None:
        """Give a learner with a replay buffer the rollouts of earlier iterations again."""
        if self._learner.memory_steps == 0:
            return
        for iteration in self._reader.iterations():
            older = self._stages.first_iteration <= iteration < self._newest.number
            rollout = self._collector.recall(iteration) if older else None
            if rollout is not None:
                self._learner.remember(rollout)
                _logger.info("Remembered %d steps of iteration %d.", rollout.steps, iteration)

    def _forget_rollouts(self, before: int) -> None:
        """Delete the rollouts before an iteration that are no longer needed for learning.

        While workers drive, the last iteration's rollouts stay: the embedded server removes a
        folder that becomes empty, and a worker that writes into it just then fails for a second.
        """
        remembered = self._history.iterations_of(self._learner.memory_steps)
        self._reader.delete_learned(min(before, self._newest.number - remembered) - 1)

    def _is_wait_over(self) -> bool:
        """Score checkpoints and check the pointer between two looks for rollouts.

        Without the pointer to the newest checkpoint, workers and trainer would wait for each other
        forever.
        """
        self._activity.wait(f"waits for rollouts of iteration {self._newest.number}")
        self._scoring.score(self._newest)
        if time.monotonic() >= self._rechecked + RECHECK_S:
            self._rechecked = time.monotonic()
            if self._checkpoints.repair_pointer(self._newest):
                _logger.warning("The pointer to %s was lost; it is written again.", self._newest)
        return self._lifeline.should_stop() or self._reached() is not None

    def _reached(self, *newest: IterationRecord) -> str | None:
        """Why the training is complete, with iterations that the history does not have yet."""
        history, records = self._history, [*self._history.records, *newest]
        reached = self.goals.reached(
            records,
            history.count + len(newest),
            episodes=self._episodes,
            judged=self._stages.judged(records),
        )
        if reached is None and self._stages.is_last:
            over = self._stages.over(records, self._counted())
            if over is not None:
                return (
                    f"Training is complete: its last stage, {self._stages.name}, is over: {over}."
                )
        return reached

    def _stage_over(self, collected: Collected) -> str | None:
        """Why the next stage begins now, instead of an update; None if it does not."""
        if self._stages.is_last or self._reached() is not None:
            return None
        record = self._record(collected)
        return self._stages.over(
            [*self._history.records, record],
            Counted(
                record.iteration + 1,
                record.total_steps,
                self._episodes + record.episodes,
                record.elapsed_s,
            ),
        )

    def _begin_next_stage(self, collected: Collected, why: str) -> None:
        """Publish the best weights of the stage as the first checkpoint of the next one.

        The pointer to this checkpoint is what ends the stage: before it is written, a trainer that
        starts again is in the old stage, afterwards in the new one.
        """
        over, record = self._stages.mark, self._record(collected)
        self._scoring.expect(record.iteration, collected.evaluates)
        self._history.add(record)  # a start that finds no checkpoint made with it drops it again
        self._await_evaluation(collected)
        self._scoring.score(self._newest)
        self._join_uploads()
        best = self._checkpoints.best_of_stage(self._stages.first_iteration)
        if best is None:
            weights = {n: t.contiguous() for n, t in self._learner.model.state_dict().items()}
            tensors, source = save_tensors(weights), str(self._newest)
        else:
            tensors, source = best.tensors, best.record.name
        self._newest = CheckpointName(self._newest.number + 1, record.total_steps)
        self._episodes += record.episodes
        mark = self._stages.begin_next(self._counted())
        sentence = f"{_sentence(str(over))} is over: {why}. {_sentence(str(mark))} begins with "
        sentence += f"the weights of checkpoint {source} on {mark.world}."
        _logger.info("%s", sentence)
        self._activity.say(f"begins {mark}")
        self._learner = self._build_learner(self._learner.compute.number_format)
        load_weights(self._learner.model, tensors, source)
        self._publish(record)
        note = StageNote(self._job.session, mark.name, str(self._newest), sentence)
        with suppress(OSError):  # a full disk: the journal does without
            note.write(self._job.folder)
        self._scoring.begin_stage(mark.iteration)
        row = row_of(record)
        plain.info(line_of(row))
        self._submit(self._metrics.add, row)
        self._collapsed = False
        self._cycle_began = time.monotonic()

    def _counted(self) -> Counted:
        """What was done until now."""
        newest = self._newest
        return Counted(newest.number, newest.steps, self._episodes, self._elapsed_s())

    def _record(self, collected: Collected) -> IterationRecord:
        """What is known about an iteration before anything is learned from it."""
        return collected.record(self._newest, elapsed_s=self._elapsed_s(), stage=self._stages.name)

    def _learn(self, collected: Collected) -> None:
        """Update the policy, publish it and record how the update went."""
        self._activity.say(f"learns from {collected.rollout.steps} steps")
        if self._learner.critic_warmup:
            _logger.info("The critic is new: until it is useful, this update improves it alone.")
        began = time.monotonic()
        try:
            stats = self._learner.update(
                collected.rollout,
                seed=self._job.seed + SEED_STRIDE * self._newest.number,
                on_epoch=lambda stats: plain.info(reference_log.epoch_line(stats)),
                should_stop=self._lifeline.step_done,
                steps_before=self._newest.steps - self._stages.first_step,
            )
        except UpdateInterruptedError:
            # Nothing is lost: a resumed training drives this iteration again.
            raise StopRequested from None
        except NonFiniteLossError as error:
            self._await_evaluation(collected)
            self._scoring.score_all(self._newest)
            what = f"NaN detected in iteration {self._newest.number}: {str(error).rstrip('.')}"
            self._roll_back("nan", what)
            raise self._not_a_number(error) from None
        if self._learner.most_samples is not None and not self._is_short_of_gpu_memory:
            self._is_short_of_gpu_memory = True
            _logger.warning(
                "The memory of the GPU is too small for a whole minibatch. From now on, gradients "
                "of %d samples at a time are added up, with the same result; a smaller batch_size "
                "is faster.",
                self._learner.most_samples,
            )
        ended = time.monotonic()
        cycle_s = ended - self._cycle_began
        self._cycle_began = ended
        driven = self._record(collected)
        iteration, steps = driven.iteration, driven.steps
        self._newest = CheckpointName(iteration + 1, driven.total_steps)
        self._episodes += driven.episodes

        last = stats[-1] if stats else None
        numbers = {} if last is None else last.metrics()
        self._scoring.expect(iteration, collected.evaluates)
        record = replace(
            driven,
            entropy=numbers.get("losses/entropy", math.nan),
            surrogate_loss=numbers.get("losses/policy_loss", math.nan),
            value_loss=numbers.get("losses/value_loss", math.nan),
            kl=numbers.get("losses/approx_kl", math.nan),
            actor_loss=numbers.get("losses/actor_loss"),
            critic_loss=numbers.get("losses/qf_loss"),
            alpha=numbers.get("losses/alpha"),
            steps_per_s=steps / cycle_s,
            real_time_factor=collected.simulated_s / cycle_s,
            learn_s=ended - began,
            exchange_s=max(0.0, cycle_s - collected.drive_s - (ended - began)),
        )
        reason = self._reached(record)
        if reason is not None:
            self._mark_end(reason)
        self._publish(record)
        self._history.add(record)
        row = row_of(record, last)
        plain.info(line_of(row))
        self._submit(self._metrics.add, row)
        if reason is not None:
            self._await_evaluation(collected)
        self._scoring.score(self._newest)
        fallen = self._history.collapse(self._checkpoints.best_name())
        for alarm in trends(self._history.records):
            if alarm.subject not in self._alarmed:
                _logger.warning("Warning: %s. %s", alarm.text, alarm.remedy)
            self._alarmed.add(alarm.subject)
        if fallen is not None and not self._collapsed:
            _logger.warning("%s.", fallen)
        self._collapsed = fallen is not None
        if fallen is not None and reason is None:
            self._roll_back("collapse", fallen[0].upper() + fallen[1:])

    def _roll_back(self, reason: Reason, what: str) -> None:
        """Return if the training cannot or may not go back to an older checkpoint.

        Raises:
            RolledBack: It goes back.
        """
        self._join_uploads()
        lr = self._learner.config.lr
        first = self._stages.first_iteration
        done = self._rollbacks.decide(
            reason, what, self._newest, lr, self._elapsed_s(), first=first
        )
        if done is not None:
            _logger.warning(
                "%s This is rollback %d of %d (DR_TRAIN_MAX_ROLLBACKS).",
                done.sentence,
                self._rollbacks.known.count,
                self._job.config.train.train_max_rollbacks,
            )
            raise RolledBack

    def _not_a_number(self, error: NonFiniteLossError) -> TrainingFailed:
        """The failure of a training whose loss is NaN."""
        remedy = (
            "Lower `lr` to a third, or set `max_grad_norm` to 0.5, in hyperparameters.json, then "
            "continue with `dr-start-training --resume`. DR_TRAIN_MAX_ROLLBACKS=2 does it "
            "without you."
        )
        best = CheckpointName.parse(self._checkpoints.best_name() or "")
        if best is not None:
            remedy += f" Or start a new model from checkpoint {best.number}, the best, with "
            remedy += "DR_LOCAL_S3_PRETRAINED=True."
        return TrainingFailed(
            "NaN detected in loss function, aborting training. "
            f"Iteration {self._newest.number}: {error} "
            "The weights from before this iteration are kept as the last checkpoint.",
            remedy=remedy,
        )

    def _await_evaluation(self, collected: Collected) -> None:
        """Wait for the evaluation that a worker still drives, if there is one."""
        if collected.evaluates is not None:
            self._activity.wait(f"waits for the evaluation of checkpoint {collected.evaluates}")
            self._scoring.wait(collected.evaluates, collected.drive_s, self._lifeline.should_stop)

    def _publish(self, learned: IterationRecord | None = None) -> None:
        """Publish the weights and the iteration that made them, None for the first ones.

        Optimizer state and graph are uploaded while the workers already drive with the new weights.
        Once this process was asked to stop, nobody waits for the weights, and the state may come
        too late: then the checkpoint is published with its state or not at all.
        """
        self._join_uploads()
        tensors = self._learner.optimizer.tensors()
        moments = save_tensors(tensors) if tensors and self._lifeline.should_stop() else None
        state = {name: t.contiguous() for name, t in self._learner.model.state_dict().items()}
        weights = save_tensors(state)
        record = self._checkpoints.save(
            self._newest.number,
            self._newest.steps,
            weights,
            optimizer=moments,
            counters=Counters(
                episodes=self._episodes,
                elapsed_s=self._elapsed_s(),
                number_format=self._learner.compute.number_format,
                learned=learned,
                seed=self._job.seed,
                inputs=self._inputs,
                critic_warmup=self._learner.critic_warmup or None,
                rollbacks=self._rollbacks.known.count or None,
                stage=self._stages.mark,
            ),
        )
        plain.info("Checkpoint> Saving in path=['%s']", record.name)
        if tensors and moments is None:
            self._submit(self._checkpoints.attach_optimizer, record, save_tensors(tensors))
        self._submit(self._graphs.write, record.number, weights)
        self._submit(self._thin_traces, self._newest.number)

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

    def _submit(self, task: Callable[P, object], *arguments: P.args, **named: P.kwargs) -> None:
        """Do something in the thread of uploads."""
        self._uploads.append(self._uploader.submit(task, *arguments, **named))

    def _join_uploads(self) -> None:
        """Wait for the uploads of the last checkpoint, and raise their error."""
        while self._uploads:
            self._uploads.pop(0).result()

    def _elapsed_s(self) -> float:
        return self._elapsed_before_s + time.monotonic() - self._started

    def _finish_files(self) -> None:
        """Write the files that grow for the last time."""
        self._uploader.submit(self._metrics.finish)
        self._history.finish()
        self._uploader.shutdown()

    def _mark_end(self, reason: str) -> None:
        """Tell the simulation workers to drive no further iteration."""
        end = TrainingEnd(self._job.session, reason)
        self._bucket.put(keys.finished(self._prefix), end.encode())

    def _finish(self, reason: str) -> None:
        """Complete everything, and give the supervisor the reason."""
        self._scoring.score_all(self._newest)
        self._join_uploads()
        self._mark_end(reason)
        self._forget_rollouts(before=self._newest.number)
        self._finish_files()
        self._activity.say("finished")
        WorkerExit(reason, "", 0).write(self._job.folder, "trainer")
        _logger.info(reason)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def learn(job: Job, lifeline: Lifeline) -> None:
    """Learn until the training ends; after a rollback, begin again from the bucket."""
    goals = None
    while True:
        trainer = Trainer(job, lifeline, goals)
        try:
            trainer.run()
        except RolledBack:
            goals = trainer.goals
            continue
        return


def main(job: Job, lifeline: Lifeline) -> None:
    """Run the trainer in this process."""
    flush_denormals()
    learn(job, lifeline)


if __name__ == "__main__":
    worker_process.run("trainer", main)
