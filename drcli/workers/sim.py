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
from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.job import Job
from drcli.exchange.rollout_manifest import Driving, Manifest, session_of_worker
from drcli.exchange.scores import EvaluationResult
from drcli.exchange.stage import StageMark
from drcli.exchange.trace import csv_text, schedule
from drcli.formats.build_network import build_policy, load_weights
from drcli.learn.compute import flush_denormals
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.modelfiles.network_shape import Design
from drcli.store import keys
from drcli.store.best_checkpoint import write_evaluation
from drcli.store.checkpoints import CheckpointStore
from drcli.store.repair import Model, repair_metrics
from drcli.store.rollout_writer import RolloutWriter
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

SEED_STRIDE = 7_919
"""Keeps the random numbers of workers apart."""


class SimWorker:
    """One simulation worker, from its first checkpoint to the end of the training."""

    _metrics: TrainingMetrics

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
        own = Model(self._bucket, self._prefix, model.metrics_prefix, model.metric, (worker,))
        for sentence in repair_metrics(own):
            _logger.warning(sentence)
        self._entered = False
        self._simulation: Simulation | None = None
        self._second: SecondTrack | None = None
        self._stage = self._stage_of(self._checkpoints.stage_of_newest())
        self._first_step = 0
        self._enter()
        self._budget = EvaluationBudget(train.train_eval_share)
        self._lag = int(overlaps(train))
        self._evaluated = -1
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
        if self._simulation is not None:
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
                load_reward(self._bucket, self._prefix, folder, trials, stage),
                num_threads=self._threads,
                seed=seed,
            )

    def run(self) -> None:
        """Drive until the training ends or somebody wants this worker to stop."""
        try:
            self._drive()
        except (StopRequested, RewardError):
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
            self._iterate(iteration, name)
            iteration += 1

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
        manifest = Manifest(iteration, self._share.worker, str(name), session)
        writer = RolloutWriter(self._bucket, self._prefix, manifest)
        trials = self._trials if self._evaluates(name) else 0
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
            self._driven_steps += episode.steps
            shard.append(episode)
            last = len(training) == len(numbers)
            if last or sum(e.steps for e in shard) >= SHARD_STEPS:
                writer.add(episodes_of(shard))
                shard.clear()
            if last:
                evaluates = name.number if trials else None
                notes = Driving(drive_s=driven_s(), evaluates=evaluates)
                # Trace and metrics first: once the manifest is there, the trainer learns, and the
                # iteration is not driven again if this worker dies. Rollouts are sent meanwhile.
                self._publish_training(iteration, name, training, (begin, begin + driven_s()))
                writer.finish(notes)
                self._delivered_s = time.monotonic()
                if len(evaluation) < trials:
                    self._activity.say(f"evaluates checkpoint {name.number}")

        try:
            plans = self._plans(numbers, trials)
            self._driver.drive(plans, collect, self._lifeline.step_done, self._epsilon(name))
        except (StopRequested, RewardError):
            writer.abandon()
            raise
        if evaluation:
            steps = sum(len(e.rows) for e in evaluation)
            share = steps / (steps + sum(len(e.rows) for e in training))
            took_s, alone_s = driven_s(), 0.0
            self._add_evaluation(iteration, name, evaluation, numbers.stop)
            if self._second is not None:
                self._activity.say(f"evaluates checkpoint {name.number} on {self._second.world}")
                second = self._second.evaluate(trials, self._lifeline.step_done)
                alone_s = driven_s() - took_s
                write_evaluation(
                    self._bucket, self._prefix, name.number, replace(self._result, second=second)
                )
                _logger.info("Checkpoint %d %s", name.number, sentence_of(second))
            if self._drives > 1:  # the first drive may include compilation
                self._budget.spend(share * took_s + alone_s)

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

    def _plans(self, numbers: range, trials: int) -> list[Plan]:
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
        length_m, worker = self._track.length_m, self._share.worker
        key = keys.training_trace(
            self._prefix, iteration, worker=worker, workers=self._share.workers
        )
        self._driven_before = self._bucket.exists(key)
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
        self._result = EvaluationResult(
            checkpoint=str(name),
            progress=[float(e.progress) for e in episodes],
            reward=[float(e.reward) for e in episodes],
            lap_s=[float(e.duration_s) for e in episodes if e.completed],
        )
        key = keys.evaluation_result(self._prefix, name.number)
        self._evaluated_before = self._bucket.exists(key)
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
