"""The trainer worker: learns from every iteration's rollouts and publishes the next checkpoint.

Run by the supervisor as `python -m drcli.worker.train`.
"""

import json
import os
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from drcli.errors import TrainingFailed
from drcli.hyperparameters import Hyperparameters
from drcli.job import Job, LastWords
from drcli.learn.buffer import Rollout
from drcli.learn.policy import ActorCritic
from drcli.learn.ppo import PPO, EpochStats, NonFiniteLossError, UpdateInterruptedError
from drcli.learn.precision import choose_compute, flush_denormals
from drcli.learn.state import optimizer_tensors, restore_optimizer
from drcli.model_metadata import ModelMetadata
from drcli.store import keys
from drcli.store.bucket import ObjectMissing, get_json
from drcli.store.checkpoints import CheckpointStore
from drcli.store.collection import RolloutReader
from drcli.store.connect import open_bucket
from drcli.store.episodes import Episodes, join_episodes
from drcli.store.history import History, IterationRecord
from drcli.store.rollouts import Manifest
from drcli.worker import announce, process
from drcli.worker.learning import policy_spec, ppo_config
from drcli.worker.process import Activity, Lifeline, StopRequested

SEED_STRIDE = 1_000_003
"""Keeps the random numbers of one iteration apart from those of the next."""

UNFINISHED_MS = 999_999.0
"""Lap time of an unfinished lap, milliseconds. Source: the reference simulator."""

PATIENCE_S = 60.0
"""How long the trainer waits for the other workers once the first has delivered, at least."""


@dataclass(frozen=True)
class Collected:
    """One iteration's rollouts and what the workers say about them."""

    rollout: Rollout
    progress: list[float]
    rewards: list[float]
    lap_s: list[float]
    simulated_s: float
    drive_s: float


class TrainingOver(Exception):
    """Raised where the trainer finds a reason to end while it waits."""


class Trainer:
    """The learner of one run, from its first checkpoint to the end."""

    def __init__(self, job: Job, lifeline: Lifeline) -> None:
        s = job.settings
        self._job = job
        self._settings = s
        self._lifeline = lifeline
        self._prefix = s.model_prefix
        self._bucket = open_bucket(s, job.directory)
        self._activity = Activity(self._bucket, self._prefix, "trainer")
        self._activity.say("starting")
        self._checkpoints = CheckpointStore(self._bucket, self._prefix)
        self._history = History(self._bucket, self._prefix)
        self._parameters = Hyperparameters.from_bytes(
            self._bucket.get(keys.hyperparameters(self._prefix)), "hyperparameters.json"
        )
        print("Using the following hyper-parameters")
        print(self._parameters.canonical_json())
        metadata = ModelMetadata.from_bytes(
            self._bucket.get(keys.model_metadata(self._prefix)), "model_metadata.json"
        )
        spec = policy_spec(metadata)
        compute = choose_compute(
            s.torch_precision, spec, self._parameters.batch_size, os.cpu_count() or 1
        )
        print(f"Compute> {compute.reason}")
        torch.manual_seed(job.seed)
        self._ppo = PPO(ActorCritic(spec), ppo_config(self._parameters), compute)
        self._number = 0
        self._steps = 0
        self._episodes = 0
        self._elapsed_before_s = 0.0
        self._started = time.monotonic()
        self._cycle_began = time.monotonic()
        self._unscored: set[int] = set()
        self._laps_done = False
        self._uploader = ThreadPoolExecutor(1, thread_name_prefix="optimizer-upload")
        self._optimizer_upload: Future[object] | None = None

    def run(self) -> None:
        """Learn until there is a reason to end."""
        self._restore()
        reader = RolloutReader(self._bucket, self._prefix)
        while True:
            reason = self._reason_to_end()
            if reason is not None:
                self._finish(reason)
                return
            try:
                collected = self._collect(reader)
            except TrainingOver:
                continue
            self._learn(collected)
            reader.delete_learned(self._number - 1)

    # Beginning.

    def _restore(self) -> None:
        """Go on from the newest intact checkpoint, or publish the first one."""
        found = self._checkpoints.load_latest(with_optimizer=True)
        if found is None:
            self._publish()
            return
        for damage in found.damaged:
            print(f"Checkpoint> Passed over {damage}")
        self._ppo.model.load_state_dict(load_tensors(found.tensors))
        if found.optimizer is None:
            print("Checkpoint> It has no optimizer state; the optimizer starts afresh.")
        else:
            restore_optimizer(self._ppo.optimizer, load_tensors(found.optimizer))
        record = found.record
        self._number, self._steps = record.number, record.steps
        self._episodes = int(record.counters["episodes"])
        self._elapsed_before_s = float(record.counters["elapsed_s"])
        self._history.keep_before(self._number)
        self._unscored = {r.iteration for r in self._history.records if not r.evaluation_progress}
        self._checkpoints.point_to(record)
        print(f"Checkpoint> Restoring from path={record.name}")

    # Driving.

    def _collect(self, reader: RolloutReader) -> Collected:
        """Wait for the workers' rollouts of this iteration and read them.

        Raises:
            TrainingOver: There is a reason to end.
            StopRequested: This process was asked to leave.
        """
        name = str(keys.CheckpointName(self._number, self._steps))
        wanted = range(self._settings.workers)
        manifests: dict[int, Manifest] = {}
        while not manifests:
            manifests = reader.wait_manifests(
                self._number,
                name,
                wanted,
                patience_s=PATIENCE_S,
                on_wait=lambda waiting: print(f"Training> {waiting}"),
                should_stop=self._is_wait_over,
            )
            if self._lifeline.should_stop():
                raise StopRequested
            if self._reason_to_end() is not None:
                raise TrainingOver
        missing = [worker for worker in wanted if worker not in manifests]
        if missing:
            print(f"Training> Going on without simulation worker {missing}.")
        parts = [part for m in manifests.values() for part in reader.read(m)]
        drive_s = max(float(m.notes["drive_s"]) for m in manifests.values())
        played = join_episodes(parts)
        parts.clear()  # ten thousand frames are 200 MB; two copies at a time are enough
        return self._within_cap(played, drive_s)

    def _is_wait_over(self) -> bool:
        """Between two looks for rollouts: obey signals, score evaluated checkpoints."""
        self._activity.say(f"waits for rollouts of iteration {self._number}")
        self._score()
        return self._lifeline.should_stop() or self._reason_to_end() is not None

    def _within_cap(self, played: Episodes, drive_s: float) -> Collected:
        """Put episodes in the order of their numbers and leave out what is too much."""
        ends = np.cumsum(played.episode_lengths)
        starts = ends - played.episode_lengths
        order = np.argsort(played.episode_numbers, kind="stable")
        cap = self._settings.train_max_steps_per_iteration
        fits = np.cumsum(played.episode_lengths[order]) <= cap
        fits[0] = True
        if not fits.all():
            print(
                f"Training> Learning from {fits.sum()} of {len(order)} episodes: "
                f"DR_TRAIN_MAX_STEPS_PER_ITERATION is {cap} steps."
            )
        order = order[fits]
        rows = np.concatenate([np.arange(starts[i], ends[i]) for i in order])
        rewards = played.rewards[rows]
        lengths = played.episode_lengths[order]
        sums = np.add.reduceat(rewards, np.cumsum(lengths) - lengths)
        duration_s = played.extras["duration_s"][order]
        completed = played.extras["completed"][order]
        return Collected(
            rollout=Rollout(
                played.frames[rows],
                played.actions[rows],
                played.log_probs[rows],
                played.values[rows],
                rewards,
                lengths,
            ),
            progress=played.extras["progress"][order].tolist(),
            rewards=sums.tolist(),
            lap_s=duration_s[completed].tolist(),
            simulated_s=float(duration_s.sum()),
            drive_s=drive_s,
        )

    # Learning.

    def _learn(self, collected: Collected) -> None:
        """Update the policy, publish it and write down how it went."""
        self._activity.say(f"learns from {collected.rollout.steps} steps")
        began = time.monotonic()
        try:
            stats = self._ppo.update(
                collected.rollout,
                seed=self._job.seed + SEED_STRIDE * self._number,
                on_epoch=self._print_epoch,
                should_stop=self._lifeline.should_stop,
            )
        except UpdateInterruptedError:
            # The rollouts stay in the bucket: a resumed trainer repeats this update from them.
            raise StopRequested from None
        except NonFiniteLossError as error:
            raise TrainingFailed(
                f"NaN detected in loss function, aborting training. Iteration {self._number}: "
                f"{error} The weights before it are kept as the last checkpoint.",
                remedy="Lower `lr`, or make rewards smaller, then go on with "
                "`dr-start-training --resume`.",
            ) from None
        ended = time.monotonic()
        drove_with = str(keys.CheckpointName(self._number, self._steps))
        cycle_s = ended - self._cycle_began
        self._cycle_began = ended
        self._number += 1
        self._steps += collected.rollout.steps
        self._episodes += len(collected.rewards)
        reason = self._reason_to_end()
        if reason is not None:
            self._mark_end(reason)
        self._publish()

        last = stats[-1]
        self._unscored.add(self._number - 1)
        self._history.add(
            IterationRecord(
                iteration=self._number - 1,
                checkpoint=drove_with,
                episodes=len(collected.rewards),
                steps=collected.rollout.steps,
                total_steps=self._steps,
                mean_reward=float(np.mean(collected.rewards)),
                mean_progress=float(np.mean(collected.progress)),
                full_laps=len(collected.lap_s),
                best_lap_s=min(collected.lap_s, default=None),
                entropy=last.entropy,
                surrogate_loss=last.surrogate_loss,
                value_loss=last.value_loss,
                kl=last.kl,
                steps_per_s=collected.rollout.steps / cycle_s,
                real_time_factor=collected.simulated_s / cycle_s,
                drive_s=collected.drive_s,
                learn_s=ended - began,
                exchange_s=max(0.0, cycle_s - collected.drive_s - (ended - began)),
                elapsed_s=self._elapsed_s(),
            )
        )
        self._score()

    def _print_epoch(self, stats: EpochStats) -> None:
        lr = self._parameters.lr
        print(announce.epoch_line(stats.surrogate_loss, stats.kl, stats.entropy, stats.epoch, lr))

    # Publishing.

    def _publish(self) -> None:
        """Put the present weights into the bucket: first they, then the pointer, then the rest.

        The optimizer state travels while the workers are already driving with the new weights.
        """
        self._join_upload()
        state = {name: t.contiguous() for name, t in self._ppo.model.state_dict().items()}
        record = self._checkpoints.save(
            self._number,
            self._steps,
            save_tensors(state),
            counters={"episodes": self._episodes, "elapsed_s": self._elapsed_s()},
        )
        print(f"Checkpoint> Saving in path=['{record.name}']")
        tensors = optimizer_tensors(self._ppo.optimizer)
        if tensors:
            self._optimizer_upload = self._uploader.submit(
                self._checkpoints.attach_optimizer, record, save_tensors(tensors)
            )

    def _join_upload(self) -> None:
        """Wait for the optimizer state of the last checkpoint; its failure is ours."""
        if self._optimizer_upload is not None:
            self._optimizer_upload.result()
            self._optimizer_upload = None

    def _score(self) -> None:
        """Take note of evaluations that have arrived, and of the best checkpoint."""
        for iteration in sorted(self._unscored):
            key = keys.evaluation_result(self._prefix, iteration)
            try:
                result = get_json(self._bucket, key)
            except ObjectMissing:
                continue
            self._unscored.discard(iteration)
            self._history.add_evaluation(iteration, result["progress"], result["lap_s"])
            metric = self._settings.train_best_model_metric
            self._checkpoints.record_evaluation(
                result["checkpoint"],
                metric_of(metric, result),
                lower_is_better=metric == "laptime",
            )
            best = keys.CheckpointName.parse(self._checkpoints.best_name() or "")
            if best is not None:
                print(
                    f"Best checkpoint number: {best.number}, Last checkpoint number: {self._number}"
                )
            done = len(result["lap_s"])
            wanted = self._job.until_laps
            self._laps_done |= (
                wanted is not None and done >= wanted and done == len(result["progress"])
            )

    # The end.

    def _elapsed_s(self) -> float:
        return self._elapsed_before_s + time.monotonic() - self._started

    def _reason_to_end(self) -> str | None:
        if self._laps_done:
            return "Training is complete: all evaluation laps of a checkpoint were completed."
        minutes = self._job.max_minutes
        if minutes is not None and time.monotonic() - self._started > 60.0 * minutes:
            return f"Training is complete: {minutes:g} minutes are over."
        if self._episodes >= self._parameters.term_cond_max_episodes:
            return f"Training is complete: {self._episodes} episodes were driven."
        return None

    def _mark_end(self, reason: str) -> None:
        """Tell the simulation workers, wherever they run, to drive no further iteration."""
        mark = {"session": self._job.session, "reason": reason}
        self._bucket.put(keys.finished(self._prefix), json.dumps(mark).encode())

    def _finish(self, reason: str) -> None:
        """Leave everything complete, and the reason for the supervisor."""
        self._join_upload()
        self._mark_end(reason)
        self._activity.say("finished")
        LastWords(reason, "", 0).leave(self._job.folder, "trainer")
        print(reason)


def metric_of(metric: str, result: dict[str, list[float]]) -> float:
    """What DR_TRAIN_BEST_MODEL_METRIC makes of an evaluation: percent, reward or milliseconds."""
    if metric != "laptime":
        return float(np.mean(result[metric]))
    unfinished = len(result["progress"]) - len(result["lap_s"])
    times_ms = [1000.0 * lap_s for lap_s in result["lap_s"]] + [UNFINISHED_MS] * unfinished
    return float(np.mean(times_ms))


def main(job: Job, lifeline: Lifeline) -> None:
    """The loop of the trainer, to be run as a process."""
    flush_denormals()
    Trainer(job, lifeline).run()


if __name__ == "__main__":
    process.run("trainer", main)
