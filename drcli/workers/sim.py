"""The simulation worker: drives with each new checkpoint and puts what it drove into the bucket.

Run by the supervisor as `python -m drcli.workers.sim K`, K counting the workers from 0.
"""

import os
import sys
import time
from collections.abc import Callable

import torch
from safetensors.torch import load as load_tensors

from drcli.base import signal_guard
from drcli.base.log import get_logger, plain
from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.job import Job
from drcli.exchange.rollout_manifest import Driving, Manifest, session_of_worker
from drcli.exchange.scores import EvaluationResult
from drcli.exchange.trace import csv_text, schedule
from drcli.learn.compute import flush_denormals
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.modelfiles.network_shape import Design
from drcli.store import keys
from drcli.store.best_checkpoint import write_evaluation
from drcli.store.checkpoints import CheckpointStore
from drcli.store.repair import Model, repair_metrics
from drcli.store.rollout_writer import RolloutWriter
from drcli.workers import reference_log, worker_process
from drcli.workers.build_learner import build_policy
from drcli.workers.build_race import (
    actions_of,
    build_simulation,
    load_reward,
    load_world,
    longest_episode,
    reward_failure,
)
from drcli.workers.cores import cores, driving_threads, overlaps
from drcli.workers.driving import Driven, Driver, Pilot, Plan, episodes_of
from drcli.workers.episode_share import EvaluationBudget, Share
from drcli.workers.metrics_file import TrainingMetrics
from drcli.workers.wait_for_trainer import CheckpointWaiter
from drcli.workers.worker_process import Activity, Lifeline, StopRequested
from drsim.episode.episode import EpisodeRules
from drsim.errors import RewardError
from drsim.track.worlds import directed

_logger = get_logger(__name__)

SHARD_STEPS = 256
"""Steps after which finished episodes travel to the bucket: about 2 MB."""

SEED_STRIDE = 7_919
"""Keeps the random numbers of one worker apart from those of the next."""


class SimWorker:
    """One simulation worker, from its first checkpoint to the end of the training."""

    def __init__(self, job: Job, lifeline: Lifeline, worker: int) -> None:
        train, model = job.config.train, job.config.model
        race = job.config.race(worker)
        self._job = job
        self._race = race
        self._lifeline = lifeline
        self._prefix = model.prefix
        self._bucket = worker_process.open_own_bucket(job, lifeline)
        self._activity = Activity(self._bucket, self._prefix, f"sim-{worker}")
        self._activity.say("starting")
        self._checkpoints = CheckpointStore(self._bucket, self._prefix)
        design = Design.of_model(self._bucket, self._prefix)
        metadata, parameters = design.metadata, design.parameters
        self._share = Share(worker, train.workers, parameters.num_episodes_between_training)
        plain.info(reference_log.start_lines(self._prefix, race, metadata, parameters, "TRAINING"))

        threads = driving_threads(train)
        torch.set_num_threads(1)
        _logger.info("Using %d of %d cores for motion, cameras and policy.", threads, cores())
        self._parameters = parameters
        self._model = build_policy(metadata, parameters)
        self._trials = _evaluation_trials(job) if worker == 0 else 0
        num_cars = race.train_lanes or self._share.count + self._trials
        reward = load_reward(self._bucket, self._prefix, job.folder / f"sim-{worker}", num_cars)
        self._track = directed(load_world(race), reverse=race.train_reverse_direction)
        actions = actions_of(metadata)
        seed = job.seed + SEED_STRIDE * worker
        simulation = build_simulation(
            race,
            "training",
            metadata,
            self._track,
            num_cars=num_cars,
            reward=reward,
            rules=EpisodeRules(max_steps=longest_episode(self._track, actions)),
            num_threads=threads,
            seed=seed,
        )
        self._driver = Driver(
            simulation, [Pilot(DataParallelPolicy(self._model, threads), actions)], seed
        )
        own = Model(
            self._bucket,
            self._prefix,
            model.metrics_prefix,
            model.metric,
            workers=(worker,),
        )
        for sentence in repair_metrics(own):
            _logger.warning(sentence)
        self._metrics = TrainingMetrics(
            self._bucket,
            keys.training_metrics(model.metrics_prefix, worker),
            model.metric,
            self._share,
            first=keys.training_metrics(model.metrics_prefix, 0) if worker else None,
        )
        self._total_steps = 0
        self._budget = EvaluationBudget(train.train_eval_share)
        self._lag = int(overlaps(train))
        self._newest = -1
        self._evaluated = -1
        self._drives = 0
        self._warm = False
        self._driven_steps = 0
        self._driven_before = False
        self._evaluated_before = False
        self._handed_in_s = time.monotonic()
        self._waiter = CheckpointWaiter(
            self._bucket,
            self._prefix,
            job.session,
            worker,
            train.workers,
            should_stop=lifeline.should_stop,
            say=self._activity.say,
        )

    def run(self) -> None:
        """Drive with one checkpoint after the other until the training is over.

        Where driving and learning overlap, an iteration is driven with the checkpoint that the
        learner is just improving; else with its result.
        """
        iteration = 0
        while True:
            name = self._waiter.wait(
                max(0, iteration - self._lag),
                self._newest,
                self._driven_steps,
                self._handed_in_s,
            )
            if name is None:
                plain.info("Received termination signal from trainer. Goodbye.")
                return
            if name.number < iteration - self._lag:
                # The trainer went back to an older checkpoint, or rollouts are lost.
                iteration = 0
                self._evaluated = -1
            self._newest = name.number
            iteration = max(iteration, name.number)
            self._total_steps = name.steps
            checkpoint = self._checkpoints.load(str(name))
            self._waiter.learn_from(checkpoint.record)
            self._model.load_state_dict(load_tensors(checkpoint.tensors))
            self._iterate(iteration, name)
            iteration += 1

    def _iterate(self, iteration: int, name: CheckpointName) -> None:
        """Drive this worker's share of an iteration and publish everything about it."""
        numbers = self._share.numbers(iteration)
        self._metrics.keep_before(iteration)
        self._activity.say(f"drives iteration {iteration}")
        training: list[Driven] = []
        evaluation: list[Driven] = []
        self._driven_steps = 0
        self._drives += 1  # one that is driven again must not write over what may be being read
        session = session_of_worker(self._job.session, os.getpid(), self._drives)
        manifest = Manifest(iteration, self._share.worker, str(name), session)
        writer = RolloutWriter(self._bucket, self._prefix, manifest)
        shard: list[Driven] = []
        evaluated = self._evaluates(name)
        trials = self._trials if evaluated else 0
        begin = time.time()

        def collect(episode: Driven) -> None:
            if episode.phase == "evaluation":
                evaluation.append(episode)
                if len(evaluation) == trials:  # at once: whatever ends the drive, these count
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
                evaluates = name.number if evaluated else None
                writer.finish(Driving(drive_s=time.time() - begin, evaluates=evaluates))
                self._handed_in_s = time.monotonic()
                self._publish_training(iteration, training, (begin, time.time()))
                self._activity.say(f"evaluates checkpoint {name.number}")

        try:
            plans = self._plans(numbers, trials)
            self._driver.drive(plans, collect, self._lifeline.should_stop, self._epsilon())
        except StopRequested:
            writer.abandon()
            raise
        except RewardError as error:
            writer.abandon()
            raise reward_failure(error) from None
        if evaluation:
            steps = sum(len(e.rows) for e in evaluation)
            share = steps / (steps + sum(len(e.rows) for e in training))
            if self._warm:  # the first iteration may have compiled, which is nobody's share
                self._budget.spend(share * (time.time() - begin))
            self._note_evaluation(iteration, name, evaluation, numbers.stop)
        self._warm = True

    def _evaluates(self, name: CheckpointName) -> bool:
        """Whether the checkpoint is to be evaluated beside the driving, which takes time."""
        if not self._trials or name.number == self._evaluated:
            return False
        if self._job.until_laps is None and not self._budget.allows_another():
            return False
        self._evaluated = name.number
        return True

    def _epsilon(self) -> Callable[[int], float] | None:
        """The share of blind actions by the steps of this iteration; None without such."""
        p = self._parameters
        if p.exploration_type != "e-greedy":
            return None
        before, workers = self._total_steps, self._share.workers

        def share(driven: int) -> float:
            done = min(1.0, (before + driven * workers) / p.epsilon_steps)
            return 1.0 + (p.e_greedy_value - 1.0) * done

        return share

    def _plans(self, numbers: range, trials: int) -> list[Plan]:
        """The training episodes of an iteration, and trials of its checkpoint."""
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
        # A deterministic policy drives every lap from one start alike, so trials start at
        # different places: together they say whether the car gets around from everywhere.
        return plans + [
            Plan(trial, "evaluation", (offset + trial / trials) % 1.0) for trial in range(trials)
        ]

    def _publish_training(
        self, iteration: int, episodes: list[Driven], wall_clock: tuple[float, float]
    ) -> None:
        episodes.sort(key=lambda episode: episode.number)
        schedule(episodes, self._metrics.clock_s)
        self._metrics.add(iteration, episodes)
        length_m = self._track.length_m
        trace = csv_text(episodes, length_m, wall_clock)
        key = keys.training_trace(
            self._prefix, iteration, worker=self._share.worker, workers=self._share.workers
        )
        self._driven_before = self._bucket.exists(key)
        if not self._driven_before:  # else they are in the log already
            worker, steps = self._share.worker, self._total_steps
            lines = reference_log.training_lines(
                episodes, worker, length_m, steps, iteration, wall_clock[1]
            )
            plain.info(lines)
        self._bucket.put(key, trace.encode())

    def _publish_evaluation(self, name: CheckpointName, episodes: list[Driven]) -> None:
        """Tell the trainer how a checkpoint did in all its trials."""
        episodes.sort(key=lambda episode: episode.number)
        result = EvaluationResult(
            checkpoint=str(name),
            progress=[float(e.progress) for e in episodes],
            reward=[float(e.reward) for e in episodes],
            lap_s=[float(e.duration_s) for e in episodes if e.completed],
        )
        key = keys.evaluation_result(self._prefix, name.number)
        self._evaluated_before = self._bucket.exists(key)
        write_evaluation(self._bucket, self._prefix, name.number, result)

    def _note_evaluation(
        self,
        iteration: int,
        name: CheckpointName,
        episodes: list[Driven],
        last_episode: int,
    ) -> None:
        """Put an evaluation into metrics and log, behind the training episodes beside it."""
        schedule(episodes, self._metrics.clock_s)
        self._metrics.add(iteration, [], episodes)
        if not (self._driven_before and self._evaluated_before):  # else it is in the log already
            worker, steps = self._share.worker, self._total_steps
            plain.info(
                reference_log.evaluation_lines(episodes, worker, last_episode, steps, name.number)
            )


def _evaluation_trials(job: Job) -> int:
    """Evaluation episodes of each checkpoint; never none, or there would be no best one."""
    return max(1, job.config.train.train_min_eval_trials, job.until_laps or 0)


def main(worker: int) -> Callable[[Job, Lifeline], None]:
    """The loop of worker K, to be run as a process."""

    def loop(job: Job, lifeline: Lifeline) -> None:
        flush_denormals()
        signal_guard.install()
        SimWorker(job, lifeline, worker).run()

    return loop


if __name__ == "__main__":
    index = int(sys.argv[1])
    worker_process.run(f"sim-{index}", main(index))
