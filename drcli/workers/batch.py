"""Gathers what the simulation workers drove with a checkpoint, as the learner takes it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drcli.base.log import get_logger
from drcli.learn.rollout_buffer import Rollout
from drcli.store.bucket import ObjectDamaged, ObjectMissing
from drcli.store.episode_encoding import Episodes
from drcli.store.keys import CheckpointName
from drcli.store.rollout_collection import RolloutReader, Waiting
from drcli.store.rollouts import Manifest

_logger = get_logger(__name__)

FIRST_PATIENCE_S = 600.0
"""How long to wait for anybody before saying so again."""

LEAST_PATIENCE_S = 20.0
"""How long to wait for the others once the first has delivered, at least: time to bring back a
worker that died."""


@dataclass(frozen=True)
class Collected:
    """One iteration's rollouts and what the workers say about them.

    Attributes:
        rollout: The episodes.
        progress: Percent of the lap of each episode.
        rewards: Sum of rewards of each episode.
        lap_s: Durations of the completed laps, simulated seconds.
        simulated_s: Simulated seconds of all episodes.
        drive_s: Wall time of the slowest worker.
        checkpoint: Name of the checkpoint that drove, the older one if there were two.
        evaluates: Number of the checkpoint whose evaluation follows, None without one.
    """

    rollout: Rollout
    progress: list[float]
    rewards: list[float]
    lap_s: list[float]
    simulated_s: float
    drive_s: float
    checkpoint: str
    evaluates: int | None


class Collector:
    """Waits for all workers of a run, but for none of them too long."""

    def __init__(self, reader: RolloutReader, workers: int, max_steps: int) -> None:
        """Begin.

        Args:
            reader: The bucket's rollouts.
            workers: How many simulation workers there are.
            max_steps: Most steps of an iteration.
        """
        self._reader = reader
        self._workers = workers
        self._max_steps = max_steps
        self._absent: set[int] = set()

    def collect(
        self, iteration: int, checkpoints: Sequence[str], should_stop: Callable[[], bool]
    ) -> Collected | None:
        """Wait for an iteration's rollouts and read them.

        Once the first worker has delivered, the others get as long again. One that was missing in
        the iteration before is not waited for.

        Args:
            iteration: Which.
            checkpoints: What may have driven them, the newest last.
            should_stop: Asked at every look.

        Returns:
            None when `should_stop` ended the wait, and where parts are gone or damaged: the workers
            drive the iteration once more then.
        """
        everybody = set(range(self._workers))
        manifests = self._wait(iteration, checkpoints, {}, 1, FIRST_PATIENCE_S, should_stop)
        while not manifests and not should_stop():
            manifests = self._wait(iteration, checkpoints, {}, 1, FIRST_PATIENCE_S, should_stop)
        expected = everybody - self._absent
        if manifests and not expected <= manifests.keys() and not should_stop():
            took_s = max(map(_drive_s, manifests.values()))
            patience_s = max(LEAST_PATIENCE_S, took_s)
            manifests = self._wait(
                iteration, checkpoints, manifests, len(expected), patience_s, should_stop
            )
        if not manifests:
            return None
        self._absent = everybody - manifests.keys()
        if self._absent:
            _logger.warning("Continuing without simulation worker %s.", sorted(self._absent))
        try:
            # Not in the order in which they arrived: equal seeds, equal minibatches.
            return self._read([manifests[worker] for worker in sorted(manifests)])
        except (ObjectMissing, ObjectDamaged) as error:
            # Workers that wait for the trainer look after their manifests.
            _logger.warning("%s Iteration %d is driven again.", error, iteration)
            self._reader.reject(iteration, manifests)
            return None

    def recall(self, iteration: int) -> Rollout | None:
        """What is still there of an older iteration, whoever drove it; None if nothing is whole."""
        try:
            manifests = self._reader.find_manifests(iteration, range(self._workers))
            return self._read(manifests).rollout if manifests else None
        except (ObjectMissing, ObjectDamaged) as error:
            _logger.warning("Cannot learn from iteration %d again: %s", iteration, error)
            return None

    def _wait(
        self,
        iteration: int,
        checkpoints: Sequence[str],
        arrived: dict[int, Manifest],
        enough: int,
        patience_s: float,
        should_stop: Callable[[], bool],
    ) -> dict[int, Manifest]:
        return self._reader.wait_manifests(
            iteration,
            checkpoints,
            range(self._workers),
            enough=enough,
            arrived=arrived,
            patience_s=patience_s,
            on_wait=_say,
            should_stop=should_stop,
        )

    def _read(self, manifests: list[Manifest]) -> Collected:
        played = self._within_cap(self._reader.read(manifests))
        lengths, extras = played.episode_lengths, played.extras
        sums = np.add.reduceat(played.rewards, np.cumsum(lengths) - lengths)
        return Collected(
            rollout=Rollout(
                played.frames,
                played.actions,
                played.log_probs,
                played.values,
                played.rewards,
                lengths,
                last_values=extras["last_values"],
                cut=extras["cut"],
                scans=extras["scans"],
                states=extras["states"],
            ),
            progress=extras["progress"].tolist(),
            rewards=sums.tolist(),
            lap_s=extras["duration_s"][extras["completed"]].tolist(),
            simulated_s=float(extras["duration_s"].sum()),
            drive_s=max(map(_drive_s, manifests)),
            checkpoint=str(min(_name(m) for m in manifests)),
            evaluates=next((n for n in map(_evaluates, manifests) if n is not None), None),
        )

    def _within_cap(self, played: Episodes) -> Episodes:
        """Leave out the episodes that are too much, those with the highest numbers."""
        order = np.argsort(played.episode_numbers, kind="stable")
        fits = np.cumsum(played.episode_lengths[order]) <= self._max_steps
        fits[0] = True
        if fits.all():
            return played
        _logger.warning(
            "Learning from %d of %d episodes: DR_TRAIN_MAX_STEPS_PER_ITERATION is %d steps.",
            fits.sum(),
            len(order),
            self._max_steps,
        )
        return played.chosen(np.sort(order[fits]))


def _drive_s(manifest: Manifest) -> float:
    """How long the worker drove, 0 where its note about that is damaged."""
    value = manifest.notes.get("drive_s")
    return value if isinstance(value, float) and 0.0 <= value < math.inf else 0.0


def _evaluates(manifest: Manifest) -> int | None:
    """Number of the checkpoint that the worker evaluates beside, None without one."""
    value = manifest.notes.get("evaluates")
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _name(manifest: Manifest) -> CheckpointName:
    name = CheckpointName.parse(manifest.checkpoint)
    if name is None:
        raise ValueError(f"{manifest.checkpoint!r} is not the name of a checkpoint.")
    return name


def _say(waiting: Waiting) -> None:
    _logger.info(waiting)
