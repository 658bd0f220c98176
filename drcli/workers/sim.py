"""The simulation worker: drives with each new checkpoint and puts its rollouts into the bucket.

Run by the supervisor as `python -m drcli.workers.sim K [DIVISOR]`, where K counts workers from 0.
With a divisor, it drives that many times fewer cars at a time.
"""

import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import torch

from drcli.base import signal_guard
from drcli.base.log import get_logger, plain
from drcli.exchange.checkpoint import CheckpointName, checkpoint_name
from drcli.exchange.job import Job
from drcli.exchange.rollout_manifest import Driving, Manifest, session_of_worker
from drcli.exchange.scores import EvaluationResult
from drcli.exchange.stage import StageMark
from drcli.exchange.trace import csv_text, schedule, steering_changes
from drcli.formats.build_network import build_policy, load_weights
from drcli.learn.compute import flush_denormals
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.modelfiles.network_shape import Design
from drcli.store import keys
from drcli.store.best_checkpoint import write_evaluation
from drcli.store.bucket import ObjectDamaged
from drcli.store.checkpoints import CheckpointStore
from drcli.store.repair import Model, repair_metrics
from drcli.store.rollbacks import read_rollbacks
from drcli.store.rollout_writer import RolloutWriter
from drcli.store.trace_retention import TraceRetention
from drcli.workers import reference_log, worker_process
from drcli.workers.build_race import (
    actions_of,
    build_simulation,
    load_reward,
    load_world,
    longest_episode,
)
from drcli.workers.cores import cores, driving_threads, overlaps
from drcli.workers.driving import Driven, Driver, Plan, Racer, episodes_of
from drcli.workers.episode_share import EvaluationBudget, Share
from drcli.workers.metrics_file import TrainingMetrics
from drcli.workers.reward_failures import AllEpisodesDiscarded, RewardErrorsExceeded, RewardFailures
from drcli.workers.second_track import SecondTrack, sentence_of
from drcli.workers.stage_progress import parameters_of, stage_index
from drcli.workers.wait_for_trainer import CheckpointWaiter
from drcli.workers.worker_process import Activity, Lifeline, StopRequested
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.simulation import Simulation
from drsim.errors import RewardError
from drsim.track.worlds import directed

_logger = get_logger(__name__)

SHARD_STEPS = 256
"""Steps after which finished episodes are sent to the bucket: about 2 MB."""

MOST_ATTEMPTS = 3
"""How often a worker drives its episodes of an iteration, each time with other random numbers,
before a reward function that declares all of them broken ends the training."""

_FAILURES = (StopRequested, RewardError, RewardErrorsExceeded, AllEpisodesDiscarded)

SEED_STRIDE = 7_919
"""Keeps the random numbers of workers apart."""


class SimWorker:
    """One simulation worker, from its first checkpoint to the end of the training."""

    _metrics: TrainingMetrics
    _simulation: Simulation

    def __init__(self, job: Job, lifeline: Lifeline, worker: int, divisor: int = 1) -> None:
        """Prepare; where memory is short, a `divisor` makes it drive fewer cars at a time."""
        train, model = job.config.train, job.config.model
        self._job = job
        self._worker, self._divisor = worker, divisor
        self._lifeline = lifeline
        self._prefix = model.prefix
        self._bucket = worker_process.open_own_bucket(job, lifeline)
        self._activity = Activity(self._bucket, self._prefix, f"sim-{worker}", lifeline.pulse)
        self._activity.say("starting")
        self._checkpoints = CheckpointStore(self._bucket, self._prefix)
        design = Design.of_model(self._bucket, self._prefix)
        self._design = design
        self._threads = driving_threads(train)
        torch.set_num_threads(1)
        _logger.info("Using %d of %d cores for motion, cameras and policy.", self._threads, cores())
        self._model = build_policy(design.metadata, design.parameters)
        self._failures = RewardFailures(train, worker)
        self._failures.restore(self._bucket, self._prefix)
        own = Model(self._bucket, self._prefix, model.metrics_prefix, model.metric, (worker,))
        for sentence in repair_metrics(own):
            _logger.warning(sentence)
        self._entered = False
        self._result: EvaluationResult | None = None
        self._second: SecondTrack | None = None
        self._stage = self._stage_of(self._checkpoints.stage_of_newest())
        self._first_step = 0
        self._enter()
        self._budget = EvaluationBudget(train.train_eval_share)
        self._lag = int(overlaps(train))
        self._evaluated = -1
        self._rollbacks = 0
        self._logged = -1
        self._traces = TraceRetention(self._bucket, self._prefix, train.workers, 0)
        self._forget_given_up()
        self._drives = 0
        self._driven_steps = 0
        self._delivered_s = time.monotonic()
        self._driven_before = False
        self._evaluated_before = False
        self._waiter = CheckpointWaiter(
            self._bucket,
            self._prefix,
            job.session,
            worker,
            train.workers,
            frugal=job.config.storage.cloud != "local",
            should_stop=lifeline.should_stop,
            say=self._activity.wait,
        )

    def _stage_of(self, mark: StageMark | None) -> int | None:
        """The place of the marked stage, from 0; None without a curriculum."""
        return stage_index(self._job.stages, mark) if self._job.stages else None

    def _enter(self) -> None:
        """Build the simulation of the training, or of its present stage."""
        job, worker, metadata = self._job, self._worker, self._design.metadata
        train, model = job.config.train, job.config.model
        stage = None if self._stage is None else job.stages[self._stage]
        race = job.config.race(worker) if stage is None else stage.race(worker)
        self._race = race
        self._parameters = parameters_of(stage, self._design.parameters)
        numbered = max(
            (parameters_of(each, self._design.parameters).num_episodes_between_training)
            for each in (job.stages or (None,))
        )
        share = Share(
            worker,
            train.workers,
            self._parameters.num_episodes_between_training,
            numbered if job.stages else 0,
        )
        plain.info(
            reference_log.start_lines(self._prefix, race, metadata, self._parameters, "TRAINING")
        )
        # Every checkpoint is evaluated at least once, or there would be no best checkpoint.
        wanted = job.until_laps or 0, (stage.goal.laps or 0) if stage is not None else 0
        trials = max(1, train.train_min_eval_trials, *wanted)
        self._trials = trials if worker == 0 else 0
        num_cars = -(-(race.train_lanes or share.count + self._trials) // self._divisor)
        folder = job.folder / f"sim-{worker}"
        reward = load_reward(self._bucket, self._prefix, folder, num_cars, stage)
        self._track = directed(load_world(race), reverse=race.train_reverse_direction)
        actions = actions_of(metadata)
        seed = job.seed + SEED_STRIDE * worker
        if self._entered:
            self._failures.count_calls(self._simulation.reward_calls)
            self._failures.begin_simulation()
            self._simulation.close()
        self._simulation = build_simulation(
            race,
            "training",
            metadata,
            self._track,
            num_cars=num_cars,
            reward=reward,
            rules=EpisodeRules(max_steps=longest_episode(self._track, actions)),
            num_threads=self._threads,
            seed=seed,
            on_reward_error=self._failures.handle,
        )
        racer = Racer(DataParallelPolicy(self._model, self._threads), actions)
        self._driver = Driver(self._simulation, [racer], seed)
        self._share = share
        if self._entered:
            self._metrics.finish()
        self._entered = True
        self._metrics = TrainingMetrics(
            self._bucket,
            model.metrics_prefix,
            model.metric,
            share,
            stage="" if stage is None else stage.name,
        )
        second = job.config.second_race(race) if worker == 0 else None
        if self._second is not None:
            self._second.close()
        self._second = None
        if second is not None:
            self._second = SecondTrack(
                second,
                metadata,
                racer,
                load_reward(self._bucket, self._prefix, folder, -(-trials // self._divisor), stage),
                num_threads=self._threads,
                seed=seed,
                # Counted apart: its calls are none of the training.
                on_reward_error=RewardFailures(train, worker).handle,
            )

    def run(self) -> None:
        """Drive until the training ends or somebody wants this worker to stop."""
        try:
            self._drive()
        except _FAILURES:
            self._metrics.finish()
            raise
        self._metrics.finish()

    def _drive(self) -> None:
        """Drive with one checkpoint after the other until the training ends.

        If driving and learning overlap, the worker drives an iteration with the checkpoint that
        the learner is improving, else with the result.
        """
        iteration, newest = 0, -1
        while True:
            wanted = max(0, iteration - self._lag)
            name = self._waiter.wait(wanted, newest, self._driven_steps, self._delivered_s)
            if name is None:
                plain.info("Received termination signal from trainer. Goodbye.")
                return
            if name.number < iteration - self._lag:
                # The trainer went back to an older checkpoint, or rollouts are lost.
                iteration = 0
                self._evaluated = -1
                self._forget_given_up(name)
            newest = name.number
            iteration = max(iteration, newest)
            checkpoint = self._checkpoints.load(str(name))
            mark = checkpoint.record.counters.stage
            stage = self._stage_of(mark)
            self._first_step = 0 if mark is None else mark.steps
            if stage is not None and stage != self._stage:
                self._stage = stage
                self._activity.say(f"enters stage {self._job.stages[stage].name}")
                _logger.info("Stage %d, %s, begins.", stage + 1, self._job.stages[stage].name)
                self._enter()
                iteration = newest  # what was driven ahead belongs to the stage before
            self._waiter.learn_from(checkpoint.record)
            load_weights(self._model, checkpoint.tensors, checkpoint.record.name)
            self._rollbacks = checkpoint.record.counters.rollbacks or 0
            self._iterate(iteration, name)
            iteration += 1

    def _forget_given_up(self, newest: CheckpointName | None = None) -> None:
        """Note which iterations the log has already, and delete traces of iterations given up.

        Log-guru stops at an episode that it has seen before.
        """
        try:
            rollbacks = read_rollbacks(self._bucket, self._prefix)
        except ObjectDamaged:
            return
        left = [checkpoint_name(each.left).number for each in rollbacks.entries]
        self._logged = max(left, default=-1 - self._lag) + self._lag
        if left and newest is not None:
            self._traces.delete_after(newest.number + self._lag)

    def _iterate(self, iteration: int, name: CheckpointName) -> None:
        """Drive this worker's share of an iteration and publish the results."""
        numbers = self._share.numbers(iteration)
        self._metrics.keep_before(iteration)
        self._activity.say(f"drives iteration {iteration}")
        training: list[Driven] = []
        evaluation: list[Driven] = []
        shard: list[Driven] = []
        self._driven_steps = 0
        self._drives += 1  # a repeated iteration must not overwrite rollouts that are being read
        session = session_of_worker(self._job.session, os.getpid(), self._drives)
        manifest = Manifest(
            iteration, self._share.worker, str(name), session, rollbacks=self._rollbacks
        )
        writer = RolloutWriter(self._bucket, self._prefix, manifest)
        trials = self._trials if self._evaluates(name) else 0
        self._failures.begin(iteration)
        begin, began_s = time.time(), time.monotonic()

        def driven_s() -> float:
            return time.monotonic() - began_s  # somebody may set the time of day

        def collect(episode: Driven) -> None:
            if episode.phase == "evaluation":
                evaluation.append(episode)
                if len(evaluation) == trials:  # now, so that they count even if the drive fails
                    self._publish_evaluation(name, evaluation)
                return
            training.append(episode)
            if episode.discarded:
                episode.frames.clear()
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
                self._failures.count_calls(self._simulation.reward_calls)
                notes = Driving(
                    drive_s=driven_s(),
                    evaluates=name.number if trials else None,
                    reward_errors=self._failures.record.newest.failed,
                    discarded=sum(e.discarded for e in training),
                )
                # Trace and metrics first: once the manifest is there, the trainer learns, and the
                # iteration is not driven again if this worker dies. Rollouts are sent meanwhile.
                self._publish_training(iteration, name, training, (begin, begin + driven_s()))
                writer.finish(notes)
                self._delivered_s = time.monotonic()
                if len(evaluation) < trials:
                    self._activity.say(f"evaluates checkpoint {name.number}")

        try:
            for attempt in range(MOST_ATTEMPTS):
                plans = self._plans(numbers, 0 if attempt else trials, attempt)
                self._driver.drive(plans, collect, self._lifeline.step_done, self._epsilon(name))
                if self._driven_steps:
                    break
                self._give_up_or_repeat(iteration, training, attempt)
        except _FAILURES:
            writer.abandon()
            self._failures.count_calls(self._simulation.reward_calls)
            self._failures.save()
            raise
        if evaluation:
            steps = sum(len(e.rows) for e in evaluation)
            share = steps / (steps + sum(len(e.rows) for e in training))
            took_s, alone_s = driven_s(), 0.0
            self._add_evaluation(iteration, name, evaluation, numbers.stop)
            self._failures.count_calls(self._simulation.reward_calls)
            self._failures.save()  # with the failures of evaluation episodes that ended later
            if self._second is not None and self._result is not None:
                self._activity.say(f"evaluates checkpoint {name.number} on {self._second.world}")
                second = self._second.evaluate(trials, self._lifeline.step_done)
                alone_s = driven_s() - took_s
                write_evaluation(
                    self._bucket, self._prefix, name.number, replace(self._result, second=second)
                )
                _logger.info("Checkpoint %d %s", name.number, sentence_of(second))
            if self._drives > 1:  # the first drive may include compilation
                self._budget.spend(share * took_s + alone_s)

    def _give_up_or_repeat(self, iteration: int, training: list[Driven], attempt: int) -> None:
        """Prepare another attempt when all episodes of this worker were declared broken.

        Raises:
            AllEpisodesDiscarded: There were `MOST_ATTEMPTS`.
        """
        newest = [e for e in self._failures.record.total.errors if e.kind == "discard"][-1]
        what = (
            f"The reward function declared all {len(training)} episodes of iteration {iteration} "
            f"broken ({newest.text})"
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

    def _evaluates(self, name: CheckpointName) -> bool:
        """Whether to evaluate the checkpoint during this drive, which takes time."""
        if not self._trials or name.number == self._evaluated:
            return False
        by_laps = self._job.until_laps is not None
        if self._stage is not None:
            by_laps = by_laps or self._job.stages[self._stage].goal.evaluated
        evaluates = by_laps or self._budget.allows_another()
        if evaluates:
            self._evaluated = name.number
        return evaluates

    def _epsilon(self, name: CheckpointName) -> Callable[[int], float] | None:
        """E-greedy's share of uniform actions by the steps of this iteration, or None."""
        p = self._parameters
        if p.exploration_type != "e-greedy":
            return None
        workers, before = self._share.workers, self._first_step

        def share(driven: int) -> float:
            done = min(1.0, (name.steps - before + driven * workers) / p.epsilon_steps)
            return 1.0 + (p.e_greedy_value - 1.0) * done

        return share

    def _plans(self, numbers: range, trials: int, attempt: int = 0) -> list[Plan]:
        """The training episodes of an iteration, and the evaluation episodes of its checkpoint."""
        race = self._race
        offset = race.train_start_position_offset
        advance = race.train_round_robin_advance_dist if race.train_change_start_position else 0.0
        alternate = race.train_alternate_driving_direction
        plans = [
            Plan(
                number,
                "training",
                (offset + self._share.position(number) * advance) % 1.0,
                reverse=alternate and number % 2 == 1,
                attempt=attempt,
            )
            for number in numbers
        ]
        # A deterministic policy drives every lap from the same start alike. So trials start at
        # different places, and together they show whether the car gets around from everywhere.
        return plans + [
            Plan(trial, "evaluation", (offset + trial / trials) % 1.0) for trial in range(trials)
        ]

    def _publish_training(
        self,
        iteration: int,
        name: CheckpointName,
        episodes: list[Driven],
        wall_clock: tuple[float, float],
    ) -> None:
        episodes.sort(key=lambda episode: episode.number)
        schedule(episodes, self._metrics.clock_s)
        self._metrics.add(iteration, episodes)
        self._failures.save(always=self._job.config.train.reward_on_error == "count")
        length_m, worker = self._track.length_m, self._share.worker
        key = keys.training_trace(
            self._prefix, iteration, worker=worker, workers=self._share.workers
        )
        self._driven_before = iteration <= self._logged or self._bucket.exists(key)
        if not self._driven_before:  # else the log has them already
            plain.info(
                reference_log.training_lines(
                    episodes, worker, length_m, name.steps, iteration, wall_clock[1]
                )
            )
        self._bucket.put(key, csv_text(episodes, length_m, wall_clock).encode())

    def _publish_evaluation(self, name: CheckpointName, episodes: list[Driven]) -> None:
        """Give the trainer the results of all trials of a checkpoint."""
        episodes.sort(key=lambda episode: episode.number)
        key = keys.evaluation_result(self._prefix, name.number)
        self._evaluated_before = name.number <= self._logged or self._bucket.exists(key)
        sound = [episode for episode in episodes if not episode.discarded]
        if not sound:
            _logger.warning(
                "Checkpoint %d is not scored: the reward function declared all episodes of its "
                "evaluation broken.",
                name.number,
            )
            self._result = None
            return
        changes, metres = steering_changes(sound)
        self._result = EvaluationResult(
            checkpoint=str(name),
            progress=[float(e.progress) for e in sound],
            reward=[float(e.reward) for e in sound],
            lap_s=[float(e.duration_s) for e in sound if e.completed],
            steering_per_m=changes / metres if metres > 1.0 else None,
            rollbacks=self._rollbacks,
        )
        write_evaluation(self._bucket, self._prefix, name.number, self._result)

    def _add_evaluation(
        self, iteration: int, name: CheckpointName, episodes: list[Driven], last_episode: int
    ) -> None:
        """Add an evaluation to metrics and log, after the training episodes of its drive."""
        schedule(episodes, self._metrics.clock_s)
        self._metrics.add(iteration, [], episodes)
        if not (self._driven_before and self._evaluated_before):  # else the log has it already
            plain.info(
                reference_log.evaluation_lines(
                    episodes, self._share.worker, last_episode, name.steps, name.number
                )
            )


def main(job: Job, lifeline: Lifeline) -> None:
    """Run a simulation worker in this process."""
    flush_denormals()
    signal_guard.install()
    SimWorker(job, lifeline, *(int(word) for word in sys.argv[1:])).run()


if __name__ == "__main__":
    worker_process.run(f"sim-{sys.argv[1]}", main)
