"""The trainer worker, which makes checkpoints: `python -m drcli.train.trainer`."""

import time
from contextlib import suppress
from dataclasses import replace

import torch
from safetensors.torch import save as save_tensors

from drcli.base.errors import StorageError, TrainingFailed
from drcli.base.log import get_logger, plain
from drcli.base.processes import Wakeup, wake
from drcli.config.track_names import training_races
from drcli.convert.build_network import load_weights
from drcli.drive import reference_log
from drcli.learn.compute import flush_denormals
from drcli.learn.data_parallel import LearnerLostError
from drcli.learn.learner import Learner
from drcli.learn.taught import STUDENT, TaughtLearner
from drcli.learn.update_result import NonFiniteLossError, Stats
from drcli.metrics.open_sinks import FigureSender
from drcli.model import keys
from drcli.model.checkpoints import KEEP, CheckpointStore, KeepRules
from drcli.model.files.custom_files import write_model_files
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.model.repair import refuse_lost, repair
from drcli.model.traces import TraceRetention
from drcli.model.training_state import Reason
from drcli.records.checkpoint import Counters
from drcli.records.iteration import IterationRecord
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import TrainingEnd
from drcli.records.stage import StageNote
from drcli.train.checkpoint_publisher import (
    CheckpointPublisher,
    RollbackControl,
    RolledBack,
    forget_evaluations,
    restore_learner,
)
from drcli.train.episode_allocator import EpisodeAllocator
from drcli.train.goals import Goals, targets_of
from drcli.train.learner_group import LearnerGroup, learner_died, learner_group, learner_of_training
from drcli.train.learner_metrics import (
    LearnerMetrics,
    LiveFigures,
    Row,
    line_of,
    row_of,
    with_losses,
)
from drcli.train.range_growth import next_ranges
from drcli.train.rollouts import FIRST_LOOK_S, WOKEN_LOOK_S, Collected, Collector, RolloutReader
from drcli.train.scoring import Scoring
from drcli.train.training_progress import (
    LearningAlarms,
    PhaseJudge,
    TrainingProgress,
    episodes_of,
    numbered_episodes,
)
from drcli.train.wait_for_trainer import RECHECK_S
from drcli.workers import worker_process
from drcli.workers.cores import max_lag
from drcli.workers.worker_process import Activity, StopRequested, StopSignal

_logger = get_logger(__name__)

NOBODY_S = 0.25
LATE_S = 2.0
SEED_STRIDE = 1_000_003
"""Odd, so that iterations differ in the lower 32 bits of a seed; torch uses no others."""


class Trainer:
    def __init__(
        self,
        job: Job,
        stop_signal: StopSignal,
        goals: Goals | None = None,
        group: LearnerGroup | None = None,
    ) -> None:
        """`goals` are those of a trainer of this process that has gone back."""
        train, model = job.config.train, job.config.model
        self._job = job
        self._stop_signal = stop_signal
        self._group = group
        bucket = worker_process.open_own_bucket(job, stop_signal)
        self._model = ModelStore(bucket, model.prefix, model.metrics_prefix, model.metric, ())
        self._activity = Activity(self._model, "trainer", stop_signal.heartbeat)
        self._activity.say("starting")
        for sentence in repair(self._model):
            _logger.warning(sentence)
        rules = KeepRules(
            train.train_keep_milestones, train.train_keep_every, train.train_keep_max_mb * 1_000_000
        )
        self._lag = max_lag(train)
        # Those that may have driven what is learned from, and one that is scored meanwhile.
        keep = max(KEEP, self._lag + 2)
        self._checkpoints = CheckpointStore(self._model, rules, keep)
        self._history = History(self._model)
        self._metrics = LearnerMetrics(self._model)
        self._design = Design.of_model(self._model, job.inputs)
        metadata, parameters = self._design.metadata, self._design.parameters
        self._has_own_files = False
        self._rollbacks = RollbackControl(self._model, job, self._checkpoints)
        self._found = self._rollbacks.load_latest()
        counters = Counters() if self._found is None else self._found.record.counters
        before_s = max(counters.elapsed_s, self._rollbacks.known.elapsed_s)
        self._cycle_began = self._rechecked = time.monotonic()
        self._progress = TrainingProgress(
            job, self._found, self._history, before_s, taught=parameters.taught
        )
        self._stages = self._progress.stages
        torch.manual_seed(job.seed)
        self._learner = self._build_learner(counters.number_format)
        self._scoring = Scoring(
            self._model,
            self._checkpoints,
            self._history,
            model.metric,
            train.train_best_model_world if job.config.race().train_eval_world else "training",
            second=bool(job.config.race().train_eval_world),
            targets=lambda: targets_of(job, self._stages.stage),
            rollbacks=self._rollbacks.known,
            lag=self._lag,
        )
        self.goals = goals or Goals(job, parameters, before_s=before_s)
        frugal = job.config.storage.cloud != "local"
        self._wakeup = Wakeup(job.folder, "trainer")
        self._reader = RolloutReader(
            self._model,
            job.session,
            frugal=frugal,
            rollbacks=self._rollbacks.known,
            pause=self._wakeup.pause,
            first_look_s=WOKEN_LOOK_S if self._wakeup.works else FIRST_LOOK_S,
        )
        self._collector = Collector(
            self._reader, train.train_max_steps_per_iteration, ahead=self._lag > 0
        )
        self._shares = EpisodeAllocator(
            self._model,
            job.session,
            train.workers,
            self._lag,
            equal=train.train_shares == "equal",
            frugal=frugal,
        )
        self._divide_episodes()
        self._traces = TraceRetention(self._model, train.workers, train.train_traces_max_mb << 20)
        self._alarms = LearningAlarms(self._history, self._checkpoints)
        self._warned: set[str] = set()
        self._figures = LiveFigures(FigureSender([]))
        self._publisher = CheckpointPublisher(
            self._checkpoints,
            self._traces,
            stop_signal.should_stop,
            self._wake_workers,
            near=not frugal,
            sensors=metadata.sensor if train.train_frozen_graph else (),
        )

    def _build_learner(self, number_format: str | None) -> Learner:
        """It keeps the number format."""
        return learner_of_training(
            self._job.config.train,
            self._design.metadata,
            self._stages.parameters(self._design.parameters),
            self._rollbacks.known,
            number_format,
            self._group,
        )

    def _divide_episodes(self) -> None:
        parameters = self._stages.parameters(self._design.parameters)
        self._shares.begin_stage(
            episodes_of(self._progress.phase, parameters),
            numbered_episodes(self._job.stages, self._design.parameters),
            self._progress.first_iteration,
        )

    def run(self) -> None:
        try:
            self._train()
        except (StopRequested, TrainingFailed):
            try:
                self._scoring.score_all(self._progress.newest)
            except StorageError as error:
                _logger.warning("The last evaluation is not scored yet: %s", error)
            self._finish_files()
            raise
        except RolledBack:
            self._reader.close()
            self._finish_files()
            raise
        finally:
            self._activity.close()
            self._wakeup.close()
            self._shares.close()

    def _train(self) -> None:
        self._restore()
        self._figures = LiveFigures.of_trainer(
            self._job, self._design, self._history.records, self._progress.newest.steps
        )
        while (reason := self._reached()) is None:
            self._rechecked = time.monotonic()
            newest = self._progress.newest
            # What is older than the stage belongs to another one.
            oldest = max(self._progress.first_iteration, newest.number - self._lag)
            behaviour = self._checkpoints.behaviour_checkpoints(newest, oldest)
            workers = self._shares.at(newest.number)
            if not workers:
                self._is_wait_over()
                self._wakeup.pause(NOBODY_S)
                if self._stop_signal.should_stop():
                    raise StopRequested
                continue
            for share in workers:
                if share.member:
                    self._reader.look_often()
                    self._traces.cover(share.worker)
            collected = self._collector.collect(
                self._progress.newest.number,
                behaviour,
                workers,
                self._is_wait_over,
                self._shares.is_hopeless,
            )
            if self._stop_signal.should_stop():
                raise StopRequested
            if collected is not None:
                self._shares.note(collected.speeds, collected.late, self._progress.newest.number)
                over = self._stage_over(collected)
                if over is None:
                    self._learn(collected)
                else:
                    self._begin_next_stage(collected, over)
                collected = None  # frees the memory of its frames
                self._forget_rollouts(before=self._progress.newest.number - 1)
        self._finish(reason)

    def _restore(self) -> None:
        found, self._found = self._found, None
        if found is None:
            refuse_lost(self._model)
            self._publish()
            return
        for damage in found.damaged:
            _logger.warning("Skipped a damaged checkpoint: %s", damage)
        record = found.record
        forget_evaluations(self._model, newest=record.number)
        if isinstance(self._learner, TaughtLearner) and self._progress.phase is not None:
            self._learner.begin(self._progress.phase.name)
        restore_learner(self._learner, found)
        self._scoring.begin_stage(self._stages.first_iteration)
        self._history.restore(record.number, record.counters.learned)
        self._scoring.restore(self._history.records)
        self._checkpoints.restore_milestones(self._progress.newest, self._history.records)
        before = self._history.records[-1].world if self._history.records else ""
        if before not in ("", self._progress.world):
            self._scoring.begin_track(self._progress.newest.number)
            # What the newest checkpoint drove there says nothing here, either.
            forget_evaluations(self._model, newest=record.number - 1)
        problem = self._metrics.restore(self._history.records)
        if problem is not None:
            _logger.warning(problem)
        self._rollbacks.mark(found)
        self._checkpoints.point_to(record)
        if record.counters.files == self._job.files_sha256:
            self._own_files()  # the trainer before may have been cut off just before that
        if self._rollbacks.known.count:
            self._checkpoints.drop_newer(self._progress.newest)
            self._traces.delete_after(record.number + self._lag)
        lost = self._checkpoints.forget_damaged_best()
        if lost is not None:
            _logger.warning(
                "The best checkpoint is lost: %s Evaluations will choose another.", lost
            )
        plain.info("Checkpoint> Restoring from path=%s", record.name)
        self._scoring.score_all(self._progress.newest)
        self._recall()

    def _recall(self) -> None:
        """Give a replay buffer the rollouts of earlier iterations again."""
        if self._learner.memory_steps == 0:
            return
        for iteration in self._reader.iterations():
            older = self._progress.first_iteration <= iteration < self._progress.newest.number
            rollout = self._collector.recall(iteration) if older else None
            if rollout is not None:
                if self._group is not None:
                    self._group.remember(rollout)
                self._learner.remember(rollout)
                _logger.info("Remembered %d steps of iteration %d.", rollout.steps, iteration)

    def _forget_rollouts(self, before: int) -> None:
        """Delete rollouts, but not the last while workers drive.

        The embedded server removes empty folders, and a worker that writes into one just then
        fails for a second.
        """
        remembered = self._history.iterations_of(self._learner.memory_steps)
        last = min(before, self._progress.newest.number - remembered) - 1
        self._reader.forget()
        self._publisher.submit(self._reader.delete_learned, last)

    def _is_wait_over(self) -> bool:
        """Score checkpoints and check the pointer between two looks for rollouts.

        Without the pointer, workers and trainer would wait for each other forever.
        """
        reassigned = self._shares.reassign(self._progress.newest.number)
        if self._shares.nobody:
            failed = f"; the last one failed on {self._shares.failure}" * bool(self._shares.failure)
            self._activity.wait(f"waits for simulation workers to join{failed}")
        else:
            self._activity.wait(f"waits for rollouts of iteration {self._progress.newest.number}")
        self._scoring.score(self._progress.newest)
        if time.monotonic() >= self._rechecked + RECHECK_S:
            self._rechecked = time.monotonic()
            if self._checkpoints.repair_pointer(self._progress.newest):
                _logger.warning(
                    "The pointer to %s was lost; it is written again.", self._progress.newest
                )
        return reassigned or self._stop_signal.should_stop() or self._reached() is not None

    def _reached(self, *newest: IterationRecord) -> str | None:
        return self._progress.reached(self.goals, *newest)

    def _stage_over(self, collected: Collected) -> str | None:
        if self._stages.is_last or self._reached() is not None:
            return None
        return self._progress.stage_over(self._progress.record(collected))

    def _begin_next_stage(self, collected: Collected, why: str) -> None:
        """Publish the stage's best weights as the next one's first checkpoint.

        The pointer to it ends the stage: a trainer that starts before is in the old stage,
        afterwards in the new one.
        """
        over, record = self._stages.mark, self._progress.record(collected)
        self._scoring.expect(record.iteration, collected.evaluates)
        self._history.add(record)  # a start that finds no checkpoint made with it drops it again
        self._await_evaluation(collected)
        self._scoring.score(self._progress.newest)
        self._publisher.join()
        best = self._checkpoints.best_of_stage(self._stages.first_iteration)
        if best is None:
            weights = {n: t.contiguous() for n, t in self._learner.model.state_dict().items()}
            tensors, source = save_tensors(weights), str(self._progress.newest)
        else:
            tensors, source = best.tensors, best.record.name
        self._progress.advance(record)
        mark = self._stages.begin_next(self._progress.counted())
        sentence = f"{_sentence(str(over))} is over: {why}. {_sentence(str(mark))} begins with "
        sentence += f"the weights of checkpoint {source} on {mark.world}."
        _logger.info("%s", sentence)
        self._activity.say(f"begins {mark}")
        if self._progress.phase is not None:
            self._progress.begin_phase()
        self._divide_episodes()
        self._learner = self._build_learner(self._learner.compute.number_format)
        load_weights(self._learner.model, tensors, source)
        if isinstance(self._learner, TaughtLearner):
            self._learner.begin("teacher")
        self._publish(record)
        self._note(mark.name, sentence)
        self._scoring.begin_stage(mark.iteration)
        self._report(row_of(record))
        self._alarms.begin_stage()
        self._cycle_began = time.monotonic()

    def _learn(self, collected: Collected) -> None:
        self._activity.say(f"learns from {collected.rollout.steps} steps")
        if self._learner.critic_warmup:
            _logger.info("The critic is new: until it is useful, this update improves it alone.")
        began = time.monotonic()
        seed = self._job.seed + SEED_STRIDE * self._progress.newest.number
        steps_before = self._steps_before()
        try:
            if self._group is not None:
                self._group.begin_update(self._learner, collected.rollout, seed, steps_before)
            stats = self._learner.update(
                collected.rollout,
                seed,
                on_epoch=self._log_epoch,
                should_stop=self._ends_update,
                steps_before=steps_before,
            )
        except NonFiniteLossError as error:
            self._await_evaluation(collected)
            self._scoring.score_all(self._progress.newest)
            number = self._progress.newest.number
            what = f"NaN detected in iteration {number}: {str(error).rstrip('.')}"
            self._roll_back("nan", what)
            algorithm = self._design.metadata.algorithm
            raise self._rollbacks.nan_failure(error, number, algorithm) from None
        self._warn_once(
            "The memory of the GPU is too small for a whole minibatch. From now on, gradients "
            "of %s samples at a time are added up, with the same result; a smaller batch_size "
            "is faster.",
            self._learner.most_samples,
        )
        self._warn_once(
            "The GPU gets each operation by itself, because a step could not be captured as "
            "a CUDA graph: %s",
            self._learner.capture_failure,
        )
        ended = time.monotonic()
        cycle_s = ended - self._cycle_began
        self._cycle_began = ended
        driven = self._progress.record(collected)
        self._progress.advance(driven)
        last = stats[-1] if stats else None
        self._scoring.expect(driven.iteration, collected.evaluates)
        record = replace(
            with_losses(driven, last),
            steps_per_s=driven.steps / cycle_s,
            real_time_factor=collected.simulated_s / cycle_s,
            learn_s=ended - began,
            exchange_s=max(0.0, cycle_s - driven.drive_s - (ended - began)),
        )
        reason = self._reached(record)
        if reason is not None:
            self._mark_end(reason)
        self._begin_next_phase(record)
        self._change_ranges(record)
        self._publish(record)
        self._history.add(record)
        self._report(row_of(record, last))
        if reason is not None:
            self._await_evaluation(collected)
        self._scoring.score(self._progress.newest)
        fallen = self._alarms.check()
        if fallen is not None and reason is None:
            self._roll_back("collapse", fallen[0].upper() + fallen[1:])

    def _warn_once(self, sentence: str, what: object) -> None:
        """Unless there is nothing to say."""
        if what is not None and sentence not in self._warned:
            self._warned.add(sentence)
            _logger.warning(sentence, what)

    def _begin_next_phase(self, newest: IterationRecord) -> None:
        """The next checkpoint belongs to the new phase."""
        mark = self._progress.phase
        if mark is None or not isinstance(self._learner, TaughtLearner):
            return
        found = self._phase_judge().next_mark(mark, [*self._history.records, newest])
        if found is None:
            return
        self._progress.phase, why = found
        self._learner.begin(self._progress.phase.name)
        sentence = f"The phase {mark.name} is over: {why}. {_sentence(str(found[0]))} begins."
        _logger.info("%s", sentence)
        self._activity.say(f"begins the phase {found[0].name}")
        self._note(found[0].name, sentence)
        self._divide_episodes()

    def _change_ranges(self, newest: IterationRecord) -> None:
        """The next checkpoint drives with them. What has just begun drives an iteration first."""
        mark = self._progress.ranges
        if mark is None or self._progress.first_iteration > newest.iteration:
            return
        since = max(mark.iteration, self._progress.first_iteration)
        records = [*self._history.records, newest]
        found = next_ranges(replace(mark, iteration=since), records)
        if found is None:
            return
        self._progress.ranges, sentence = found
        _logger.info("%s", sentence)
        self._note("ranges", sentence)

    def _phase_judge(self) -> PhaseJudge:
        stage = self._stages.stage
        targets = targets_of(self._job, stage)
        left_s = min(-self.goals.late_s(), self._stages.left_s(self._progress.elapsed_s))
        race = self._job.config.race() if stage is None else stage.race()
        lap_time_s = min((each.lap_time_s for each in targets), default=None)
        return PhaseJudge(lap_time_s, left_s, many=len(training_races(race)) > 1)

    def _steps_before(self) -> int:
        """Of the phase or stage; a student on several tracks goes by its share of the time."""
        mark, steps = self._progress.phase, self._progress.newest.steps - self._progress.first_step
        if mark is None or mark.name != "distillation":
            return steps
        judge = self._phase_judge()
        if not judge.many:
            return steps
        return round(judge.done(mark, steps, self._history.records) * STUDENT.schedule_steps)

    def _note(self, name: str, sentence: str) -> None:
        note = StageNote(self._job.session, name, str(self._progress.newest), sentence)
        with suppress(OSError):  # a full disk: the journal does without
            note.write(self._job.folder)

    def _ends_update(self) -> bool:
        """Whether time is over; the update keeps what it has learned.

        Raises:
            StopRequested: A resumed training drives this iteration again.
        """
        if self._stop_signal.step_done():
            raise StopRequested
        # Other processes learn on, so an update that ends early must be their last one.
        may_be_stage = self._group is None or self._stages.is_last
        ends = self.goals.late_s() >= 0.0 or (
            may_be_stage and self._stages.is_time_over(self._progress.elapsed_s)
        )
        if ends:
            _logger.info("The time is over: this update ends with what it has learned until now.")
        return ends

    def _report(self, row: Row) -> None:
        plain.info("%s", line_of(row), extra={"event": "iteration", "facts": row})
        self._publisher.submit(self._metrics.add, row)
        self._figures.learned(row, self._history.records)

    def _log_epoch(self, stats: Stats) -> None:
        plain.info(reference_log.epoch_line(stats))
        self._figures.epoch(stats)

    def _roll_back(self, reason: Reason, what: str) -> None:
        """Return if that cannot or may not be done.

        Raises:
            RolledBack: It goes back.
        """
        self._publisher.join()
        lr = self._learner.config.lr
        first = self._stages.first_iteration
        done = self._rollbacks.decide(
            reason, what, self._progress.newest, lr, self._progress.elapsed_s, first=first
        )
        if done is not None:
            _logger.warning(
                "%s This is rollback %d of %d (DR_TRAIN_MAX_ROLLBACKS).",
                done.sentence,
                self._rollbacks.known.count,
                self._job.config.train.train_max_rollbacks,
            )
            raise RolledBack

    def _await_evaluation(self, collected: Collected) -> None:
        if collected.evaluates is not None:
            self._activity.wait(f"waits for the evaluation of checkpoint {collected.evaluates}")
            self._scoring.wait(
                collected.evaluates,
                collected.record.drive_s,
                lambda: self._stop_signal.should_stop() or self.goals.late_s() > LATE_S,
            )

    def _publish(self, learned: IterationRecord | None = None) -> None:
        counters = Counters(
            episodes=self._progress.episodes,
            elapsed_s=self._progress.elapsed_s,
            number_format=self._learner.compute.number_format,
            learned=learned,
            seed=self._job.seed,
            inputs=self._design.texts,  # without them, nobody could tell what its outputs mean
            files=self._job.files_sha256,
            critic_warmup=self._learner.critic_warmup or None,
            rollbacks=self._rollbacks.known.count or None,
            stage=self._stages.mark,
            phase=self._progress.phase,
            shares=self._shares.version_for(self._progress.newest.number),
            ranges=self._progress.ranges,
        )
        self._publisher.publish(self._progress.newest, self._learner, counters)
        self._own_files()

    def _own_files(self) -> None:
        """A checkpoint has learned with the files of this start."""
        if not self._has_own_files:
            self._has_own_files = True
            self._publisher.submit(write_model_files, self._model, self._job.inputs)

    def _finish_files(self, *, finished: bool = False) -> None:
        self._figures.end(self._history.records, finished=finished)
        self._publisher.submit(self._metrics.finish)
        self._history.finish()
        self._publisher.close()

    def _mark_end(self, reason: str) -> None:
        end = TrainingEnd(self._job.session, reason)
        self._model.bucket.put(keys.finished(self._model.prefix), end.encode())
        self._wake_workers()

    def _wake_workers(self) -> None:
        workers = range(self._job.config.train.workers)
        wake(self._job.folder, *(f"sim-{worker}" for worker in workers))

    def _finish(self, reason: str) -> None:
        self._scoring.score_all(self._progress.newest)
        self._publisher.join()
        self._mark_end(reason)
        self._forget_rollouts(before=self._progress.newest.number)
        self._finish_files(finished=True)
        self._activity.say("finished")
        WorkerExit(reason, "", 0).write(self._job.folder, "trainer")
        _logger.info(reason)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _learners(job: Job) -> int:
    file, metadata = map(job.inputs.get, (keys.HYPERPARAMETERS_FILE, keys.MODEL_METADATA_FILE))
    alone = file is not None and Hyperparameters.from_bytes(file.encode()).taught
    if metadata is not None:
        alone = alone or not ModelMetadata.from_bytes(metadata.encode()).algorithm.parallel
    return 1 if alone else job.config.train.train_learners


def learn(job: Job, stop_signal: StopSignal) -> None:
    """After a rollback, begin again from the bucket."""
    goals = None
    with learner_group(_learners(job)) as group:
        while True:
            try:
                trainer = Trainer(job, stop_signal, goals, group)
                trainer.run()
            except RolledBack:
                goals = trainer.goals
                continue
            except LearnerLostError as error:
                raise learner_died(error) from error
            return


def main(job: Job, stop_signal: StopSignal) -> None:
    flush_denormals()
    learn(job, stop_signal)


if __name__ == "__main__":
    worker_process.run("trainer", main)
