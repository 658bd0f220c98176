"""The simulation worker: drives with each checkpoint, and delivers its rollouts.

`python -m drcli.train.sim K [DIVISOR]`, counted from 0; with that many times fewer cars.
"""

import os
import sys
import time
from dataclasses import replace
from statistics import fmean

import torch

from drcli.base.json_record import Fingerprint
from drcli.base.log import get_logger, plain
from drcli.base.processes import Wakeup, wake
from drcli.bucket.bucket import ObjectDamaged
from drcli.convert.build_network import build_policy, load_weights
from drcli.drive.build_race import actions_of, choose_worker_device
from drcli.drive.driving import Driven, Racer, columns_of, episodes_of, log_evaluation, log_training
from drcli.learn.actor_critic import ActorCritic, Teacher
from drcli.learn.compute import driving_format, flush_denormals
from drcli.learn.cuda import GpuPolicy
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.encoders import compute_in
from drcli.live.live_scene import BLIND, facts_of
from drcli.live.live_view import LiveShow, live_show
from drcli.model import keys
from drcli.model.best_checkpoint import is_hopeful, read_scores, write_evaluation
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.model.repair import repair_metrics
from drcli.model.training_state import read_shares
from drcli.records.checkpoint import (
    CheckpointName,
    CheckpointRecord,
    Counters,
    checkpoint_name,
)
from drcli.records.iteration import CONFIRMING_LAPS
from drcli.records.job import Job
from drcli.records.rollout import Driving, Manifest, session_of_worker
from drcli.records.scores import EvaluationEpisodes, EvaluationResult
from drcli.records.stage import Stage, StageMark
from drcli.train.drive_results import DriveResults
from drcli.train.episode_share import AssignedShare, EvaluationBudget
from drcli.train.goals import Goals
from drcli.train.membership import Membership
from drcli.train.rollouts import RolloutWriter
from drcli.train.training_progress import phase_of, stage_index
from drcli.train.training_simulation import TrainingSimulation, sentence_of
from drcli.train.wait_for_trainer import POLL_S, WOKEN_POLL_S, CheckpointWaiter
from drcli.workers import worker_process
from drcli.workers.cores import cores, driving_threads, max_lag, usable_cores
from drcli.workers.reward_failures import AllEpisodesDiscarded, RewardErrorsExceeded, RewardFailures
from drcli.workers.worker_process import Activity, StopRequested, StopSignal
from drsim.errors import RewardError

_logger = get_logger(__name__)

HALF_A_LAP = 50.0
"""From this mean percent of its episodes on, a student is evaluated."""

SHARD_STEPS = 256
"""About 2 MB."""

GOAL_CREDIT_S = 10.0
"""To end the training: the first good checkpoint of the shipped files comes after half a minute."""

MOST_ATTEMPTS = 3
"""With other random numbers, when all episodes are declared broken."""

_FAILURES = (StopRequested, RewardError, RewardErrorsExceeded, AllEpisodesDiscarded)


class SimWorker:
    def __init__(
        self,
        job: Job,
        stop_signal: StopSignal,
        worker: int,
        divisor: int = 1,
        *,
        live: LiveShow | None = None,
        membership: Membership | None = None,
    ) -> None:
        """`divisor` saves memory; `membership` is of a joined worker."""
        train, model = job.config.train, job.config.model
        self._job = job
        self._worker, self._divisor = worker, divisor
        self._stop_signal = stop_signal
        self._live = live
        self._membership = membership
        bucket = worker_process.open_own_bucket(job, stop_signal, far=membership is not None)
        self._store = ModelStore(
            bucket, model.prefix, model.metrics_prefix, model.metric, (worker,)
        )
        self._activity = Activity(self._store, f"sim-{worker}", stop_signal.heartbeat)
        self._activity.say("starting")
        self._checkpoints = CheckpointStore(self._store)
        self._design = design = Design.of_model(self._store, job.inputs)
        threads = driving_threads(train) if membership is None else usable_cores(train)
        torch.set_num_threads(1)
        _logger.info("Using %d of %d cores for motion, cameras and policy.", threads, cores())
        self._model = build_policy(design.metadata, design.parameters)
        self._device = choose_worker_device(train.worker_device, worker)
        say = _logger.info if self._device.is_wanted else _logger.warning
        say("Cameras and policy are computed %s.", self._device.reason)
        self._on_gpu: GpuPolicy | None = None
        if self._device.gpu is not None:
            self._on_gpu = GpuPolicy(self._model, self._device.gpu)
        policy = self._on_gpu or DataParallelPolicy(self._model, threads)
        actions = actions_of(design.metadata)
        self._racers = [Racer(policy, actions)]
        if isinstance(self._model, ActorCritic) and self._model.spec.taught:
            self._racers.append(Racer(Teacher(self._model).eval(), actions))
        self._failures = RewardFailures(train, worker)
        self._failures.restore(self._store)
        for sentence in repair_metrics(self._store):
            _logger.warning(sentence)
        self._result: EvaluationResult | None = None
        self._simulation = self._build(self._stage_of(self._checkpoints.stage_of_newest()))
        self._results = DriveResults(job, self._store, self._simulation)
        self._results.forget_given_up()
        credit_s = GOAL_CREDIT_S if self._simulation.targets else 0.0
        self._budget = EvaluationBudget(train.train_eval_share, credit_s)
        self._judged = (
            train.train_best_model_world if job.config.race().train_eval_world else "training"
        )
        self._lag = max_lag(train)
        self._evaluated = -1
        self._goals = Goals(job, design.parameters)
        self._has_student_learned = False
        self._loaded: Fingerprint | None = None
        self._drives = 0
        self._driven_steps = 0
        self._delivered_s = time.monotonic()
        self._wakeup = Wakeup(job.folder, f"sim-{worker}")
        is_woken = self._wakeup.works and membership is None  # only on the trainer's machine
        self._waiter = CheckpointWaiter(
            self._store,
            job.session,
            worker,
            max(1, train.workers),
            lag=self._lag,
            frugal=job.config.storage.cloud != "local",
            should_stop=stop_signal.should_stop,
            say=self._activity.wait,
            pause=self._wakeup.pause,
            poll_s=WOKEN_POLL_S if is_woken else POLL_S,
            is_reassigned=None if membership is None else membership.is_reassigned,
        )

    def _stage_of(self, mark: StageMark | None) -> Stage | None:
        stages = self._job.stages
        return stages[stage_index(stages, mark)] if stages else None

    def _build(self, stage: Stage | None) -> TrainingSimulation:
        return TrainingSimulation(
            self._job,
            self._store,
            self._design,
            self._racers,
            stage,
            worker=self._worker,
            divisor=self._divisor,
            joined=self._membership is not None,
            gpu=self._on_gpu is not None,
            on_reward_error=self._failures.handle,
            observer=self._live,
        )

    def _enter(self, stage: Stage) -> None:
        self._activity.say(f"enters stage {stage.name}")
        _logger.info("Stage %d, %s, begins.", self._job.stages.index(stage) + 1, stage.name)
        self._failures.count_calls(self._simulation.reward_calls)
        self._failures.begin_simulation()
        self._simulation.close()
        self._simulation = self._build(stage)
        self._results.enter(self._simulation)

    def run(self) -> None:
        try:
            self._drive()
        except _FAILURES:
            self._results.close()
            raise
        finally:
            if self._simulation.trials:
                _logger.info("Evaluations took %s.", self._budget)
            self._activity.close()
            self._wakeup.close()
            self._simulation.close()
        self._results.close()

    def _drive(self) -> None:
        """Drive with one checkpoint after the other until the training ends.

        Each may be so many numbers older as driving may be ahead of learning.
        """
        iteration, newest = 0, -1
        while True:
            wanted = max(0, iteration - self._lag)
            if self._membership is not None:
                self._membership.is_ready(newest)
            name = self._waiter.wait(wanted, newest, self._driven_steps, self._delivered_s)
            if name is None:
                plain.info("Received termination signal from trainer. Goodbye.")
                return
            if name.number < max(wanted, newest):
                # The trainer went back to an older checkpoint, or rollouts are lost.
                iteration = 0
                self._evaluated = -1
                self._results.forget_given_up(name)
            newest = name.number
            iteration = max(iteration, newest)
            record = self._checkpoints.record(str(name))
            counters = record.counters
            stage = self._stage_of(counters.stage)
            if stage is not None and stage is not self._simulation.stage:
                self._enter(stage)
                iteration = newest  # what was driven ahead belongs to the stage before
            phase = phase_of(counters.phase, name, taught=self._design.parameters.taught)
            if phase != self._simulation.phase:
                self._simulation.enter_phase(phase)
                iteration = newest
            self._simulation.enter_ranges(counters.ranges)
            if record.tensors != self._loaded:  # else it has driven with these weights before
                self._waiter.learn_from(record)
                self._load(record)
            if self._is_assigned(iteration, counters.shares):
                self._iterate(iteration, name, counters)
            else:
                self._driven_steps = 0
            iteration += 1

    def _load(self, record: CheckpointRecord) -> None:
        learner = record.counters.number_format
        tensors = self._checkpoints.tensors(record)
        if self._on_gpu is None:
            compute_in(self._model, driving_format(learner))
        load_weights(self._model, tensors, record.name)
        if self._on_gpu is not None:
            self._on_gpu.follow(torch.bfloat16 if learner == "bf16" else torch.float32)
        self._loaded = record.tensors

    def _is_assigned(self, iteration: int, version: int | None) -> bool:
        """Whether this worker drives any episodes of an iteration."""
        shares, assigned = None, None
        if self._membership is not None:
            shares = self._membership.shares_of(iteration)
        elif version is not None:
            shares = read_shares(self._store, self._job.session, iteration)
        if shares is not None and (own := shares.of(self._worker)) is not None:
            assigned = AssignedShare(shares, own)
        self._simulation.assigned = assigned
        # Without shares, as when they are lost or of an earlier start, ours drive as ever.
        return assigned is not None or (shares is None and self._membership is None)

    def _iterate(self, iteration: int, name: CheckpointName, counters: Counters) -> None:
        simulation, rollbacks = self._simulation, counters.rollbacks or 0
        numbers = simulation.part.numbers(iteration)
        self._results.keep_before(iteration)
        self._activity.say(f"drives iteration {iteration}")
        if self._live is not None:
            facts = facts_of(simulation.race, [self._store.prefix])
            if simulation.phase is not None and simulation.phase.name == "teacher":
                facts = replace(facts, hint=BLIND)
            self._live.about(iteration, str(name), facts)
        training: list[Driven] = []
        evaluation: list[Driven] = []
        shard: list[Driven] = []
        self._driven_steps = 0
        self._drives += 1  # a repeated iteration must not overwrite rollouts that are being read
        session = session_of_worker(self._job.session, os.getpid(), self._drives)
        manifest = Manifest(iteration, self._worker, str(name), session, rollbacks=rollbacks)
        writer = RolloutWriter(self._store, manifest)
        trials = simulation.trials if self._evaluates(name, counters) else 0
        self._failures.begin(iteration)
        begin, began_s = time.time(), time.monotonic()

        def driven_s() -> float:
            return time.monotonic() - began_s  # somebody may set the time of day

        def collect(episode: Driven) -> None:
            if episode.phase == "evaluation":
                log_evaluation(episode, name.number, self._worker)
                evaluation.append(episode)
                if len(evaluation) == trials:  # now, so that they count even if the drive fails
                    self._result = self._results.score(name, evaluation, rollbacks)
                    if self._result is not None:
                        again = self._laps_to_confirm(self._result)
                        self._give(replace(self._result, confirms=again))
                return
            log_training(episode, iteration, self._worker)
            training.append(episode)
            if episode.discarded:
                episode.samples.clear()
            else:
                self._driven_steps += episode.steps
                shard.append(episode)
            last = len(training) == len(numbers)
            if last and not self._driven_steps:
                return  # nobody could learn from it: it is driven again
            if shard and (last or sum(e.steps for e in shard) >= SHARD_STEPS):
                writer.add(episodes_of(shard))
                shard.clear()
            if last:
                own = [float(e.progress) for e in training if e.racer == 0]
                self._has_student_learned = bool(own) and fmean(own) >= HALF_A_LAP
                self._failures.count_calls(simulation.reward_calls)
                notes = Driving(
                    drive_s=driven_s(),
                    evaluates=name.number if trials else None,
                    reward_errors=self._failures.record.newest.failed,
                    discarded=sum(e.discarded for e in training),
                )
                # Trace and metrics first: once the manifest is there, the trainer learns, and the
                # iteration is not driven again if this worker dies. Rollouts are sent meanwhile.
                self._failures.save()
                clock = begin, begin + driven_s()
                self._results.publish_training(iteration, name, training, clock)
                writer.finish(notes)
                wake(self._job.folder, "trainer")
                self._delivered_s = time.monotonic()
                self._results.gather()
                if len(evaluation) < trials:
                    self._activity.say(f"evaluates checkpoint {name.number}")

        def should_stop() -> bool:
            return self._stop_signal.step_done() or (
                len(training) < len(numbers)
                and self._membership is not None
                and self._membership.is_drive_over()
            )

        try:
            if self._membership is not None:
                self._membership.begin_drive(iteration, lambda: simulation.reward_calls)
            for attempt in range(MOST_ATTEMPTS):
                plans = simulation.plans(
                    numbers, 0 if attempt else trials, attempt, iteration=iteration
                )
                mark = counters.stage
                policy_steps = name.steps - (0 if mark is None else mark.steps)
                simulation.drive(plans, collect, should_stop, policy_steps)
                if self._driven_steps:
                    break
                self._give_up_or_repeat(iteration, training, attempt)
        except _FAILURES as error:
            writer.abandon()
            self._failures.count_calls(simulation.reward_calls)
            self._failures.save()
            if not isinstance(error, StopRequested) or self._stop_signal.should_stop():
                raise
            _logger.info("The trainer went on without this worker's iteration %d.", iteration)
            self._driven_steps = 0
            return
        finally:
            if self._membership is not None:
                self._membership.end_drive()
        if evaluation:
            steps = sum(len(e.rows) for e in evaluation)
            share = steps / (steps + sum(len(e.rows) for e in training))
            took_s = driven_s()
            self._results.publish_evaluation(iteration, name, evaluation, numbers.stop, begin)
            try:
                if self._result is not None:
                    self._evaluate_further(self._result, name.number)
            finally:  # with the failures of evaluation episodes that ended later
                self._failures.count_calls(simulation.reward_calls)
                self._failures.save()
            # The first drive may include compilation.
            share *= self._drives > 1
            self._budget.spend(share * took_s + driven_s() - took_s)

    def _give(self, result: EvaluationResult) -> None:
        self._result = result
        number = checkpoint_name(result.checkpoint).number
        write_evaluation(self._store, number, result)
        wake(self._job.folder, "trainer")

    def _laps_to_confirm(self, result: EvaluationResult) -> int:
        simulation, config = self._simulation, self._job.config
        if any(each.shown_by(result.progress, result.lap_s) for each in simulation.targets):
            return CONFIRMING_LAPS
        if self._judged != "training":
            return 0
        try:
            scores = read_scores(self._store)
        except ObjectDamaged:  # which the trainer repairs
            return 0
        return simulation.trials * is_hopeful(scores, result, config.model.metric)

    def _evaluate_further(self, result: EvaluationResult, number: int) -> None:
        simulation = self._simulation
        if result.confirms:
            self._activity.say(f"lets checkpoint {number} drive again from other starts")
            plans = simulation.confirmation_plans(number, result.confirms)
            again = simulation.drive_again(plans, self._stop_signal.step_done)
            sound = [episode for episode in again if not episode.discarded]
            confirmation = EvaluationEpisodes(*columns_of(sound)) if sound else None
            result = replace(result, confirms=0, confirmation=confirmation)
            self._give(result)
            if confirmation is not None:
                _logger.info(
                    "Checkpoint %d drove again from other starts: %s.", number, confirmation.laps
                )
        if simulation.held_out is not None:
            self._activity.say(f"evaluates checkpoint {number} on {simulation.held_out.name}")
            # Where they alone decide which checkpoint is the best, as many as if it drove again.
            laps = simulation.trials * (2 if self._judged == "evaluation" else 1)
            second = simulation.held_out.evaluate(laps, self._stop_signal.step_done)
            self._give(replace(result, second=second))
            _logger.info("Checkpoint %d %s", number, sentence_of(second))

    def _give_up_or_repeat(self, iteration: int, training: list[Driven], attempt: int) -> None:
        """After all episodes were declared broken.

        Raises:
            AllEpisodesDiscarded: There were `MOST_ATTEMPTS`.
        """
        what = (
            f"The reward function declared all {len(training)} episodes of iteration {iteration} "
            f"broken ({self._failures.newest_discard})"
        )
        if attempt + 1 == MOST_ATTEMPTS:
            raise AllEpisodesDiscarded(
                f"{what}, {MOST_ATTEMPTS} times with other random numbers: there is nothing to "
                "learn from.",
                remedy="Raise DiscardEpisode only where something is wrong with an episode, and "
                "continue with `dr-start-training --resume`. A bad episode teaches as much as a "
                "good one.",
            )
        _logger.warning("%s; it is driven again with other random numbers.", what)
        training.clear()

    def _evaluates(self, name: CheckpointName, counters: Counters) -> bool:
        phase = self._simulation.phase
        phase_name, assigned = "" if phase is None else phase.name, self._simulation.assigned
        promising = phase_name != "distillation" or self._has_student_learned
        trained_with = counters.inputs.get(keys.MODEL_METADATA_FILE)
        allowed = self._budget.allows_another(-self._goals.late_s(), promising=promising)
        evaluates = (
            allowed
            and bool(self._simulation.trials)
            and name.number != self._evaluated
            and phase_name != "teacher"  # the camera policy has learned nothing yet
            # Else its score would be that of other actions.
            and trained_with in (None, self._design.texts[keys.MODEL_METADATA_FILE])
            and (assigned is None or assigned.evaluates)
        )
        if evaluates:
            self._evaluated = name.number
        return evaluates


def main(job: Job, stop_signal: StopSignal) -> None:
    flush_denormals()
    worker, *divisor = (int(word) for word in sys.argv[1:])
    models = [job.config.model.prefix]
    with live_show(job, f"sim-{worker}", stop_signal.heartbeat, models, worker) as live:
        SimWorker(job, stop_signal, worker, *divisor, live=live).run()


if __name__ == "__main__":
    worker_process.run(f"sim-{sys.argv[1]}", main)
