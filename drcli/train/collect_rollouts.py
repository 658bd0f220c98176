"""Collects the rollouts of all simulation workers for the learner."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from drcli.base.log import get_logger
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.learn.rollout_buffer import Rollout
from drcli.records.checkpoint import checkpoint_name
from drcli.records.iteration import IterationRecord
from drcli.records.job import WorkerShare
from drcli.records.rollout import Episodes, Manifest
from drcli.train.rollouts import RolloutReader

_logger = get_logger(__name__)

LEAST_PATIENCE_S = 20.0
"""After the first worker has delivered: one that died must start again."""

STARTING_PATIENCE_S = 120.0
"""In the first iteration: analysis tools need the first trace of every worker."""

JOINED_PATIENCE_S = 5.0
"""Others drive the share of one that dies. With a latency of 100 ms, checkpoint and rollouts take
1.8 s.
"""

Hopeless = Callable[[WorkerShare, int, float, float], bool]
"""Whether not to wait for a share of an iteration, by its steps and the seconds left from the
beginning of its drive.
"""


@dataclass(frozen=True)
class Collected:
    """One iteration's rollouts and what the workers report about them.

    Attributes:
        record: As far as the workers know; `TrainingProgress` adds what the trainer counts. The
            checkpoint is what drove, the older one if there were two.
        simulated_s: Of all episodes together.
        evaluates: The checkpoint that a worker evaluates now.
        speeds: Steps per second by worker.
        late: Workers that were waited for in vain.
    """

    rollout: Rollout
    record: IterationRecord
    simulated_s: float
    evaluates: int | None = None
    speeds: Mapping[int, float] = field(default_factory=dict)
    late: tuple[int, ...] = ()


class Collector:
    """Waits for all simulation workers, but not too long for any of them.

    With `ahead`, workers drive an iteration before the trainer waits for it.
    """

    def __init__(self, reader: RolloutReader, max_steps: int, *, ahead: bool = False) -> None:
        self._ahead = ahead
        self._reader = reader
        self._max_steps = max_steps
        self._absent: set[int] = set()
        self._least_patience_s = STARTING_PATIENCE_S

    def collect(
        self,
        iteration: int,
        checkpoints: Sequence[str],
        workers: Sequence[WorkerShare],
        should_stop: Callable[[], bool],
        is_hopeless: Hopeless = lambda share, iteration, steps, within_s: False,
    ) -> Collected | None:
        """Wait for an iteration's rollouts and read them.

        A worker that missed the iteration before is not waited for.

        Returns:
            None if `should_stop`, or if a part is missing or damaged: workers then drive it
                again.
        """
        everybody = {share.worker for share in workers}
        joined = {share.worker for share in workers if share.member}
        wait = partial(
            self._reader.wait_manifests,
            iteration,
            checkpoints,
            everybody,
            should_stop=should_stop,
        )
        manifests = wait(enough=1)
        expected = everybody - self._absent
        if manifests and not expected <= manifests.keys() and not should_stop():
            only_joined = expected - manifests.keys() <= joined
            least_s = JOINED_PATIENCE_S if only_joined else self._least_patience_s
            counts = {share.worker: share.count for share in workers}
            first_s, most = max(m.notes.drive_s for m in manifests.values()), max(counts.values())

            def is_over(arrived: Mapping[int, Manifest], waited_s: float) -> bool:
                # Those with the largest share get as long again as the first one would have taken
                # for it; a joined worker with a part of it gets that part.
                usual_s = min(m.notes.drive_s * most / counts[k] for k, m in arrived.items())
                steps = sum(m.steps for m in arrived.values())
                episodes = sum(counts[k] for k in arrived)
                for share in workers:
                    if share.worker in arrived or share.worker not in expected:
                        continue
                    part = share.count / most if share.member else 1.0
                    within_s = usual_s + max(least_s, (1.0 + self._ahead) * part * usual_s)
                    if first_s + waited_s >= within_s:
                        continue
                    own_steps = steps * share.count / episodes
                    if not (share.member and is_hopeless(share, iteration, own_steps, within_s)):
                        return False
                return True

            manifests = wait(
                enough=len(expected | manifests.keys()), arrived=manifests, is_over=is_over
            )
        if not manifests:
            return None
        self._least_patience_s = LEAST_PATIENCE_S
        self._absent = everybody - manifests.keys()
        if self._absent:
            _logger.warning("Continuing without simulation worker %s.", sorted(self._absent))
        try:
            # In the order of the workers, so that equal seeds give equal minibatches.
            collected = self._read([manifests[worker] for worker in sorted(manifests)])
        except (ObjectMissing, ObjectDamaged) as error:
            # Waiting workers notice that their manifests are gone.
            _logger.warning("%s Iteration %d is driven again.", error, iteration)
            self._reader.reject(iteration, manifests)
            return None
        return replace(collected, late=tuple(sorted(expected - manifests.keys())))

    def recall(self, iteration: int) -> Rollout | None:
        """None if they are missing or damaged."""
        try:
            manifests = self._reader.find_manifests(iteration)
            return self._read(manifests).rollout if manifests else None
        except (ObjectMissing, ObjectDamaged) as error:
            _logger.warning("Cannot learn from iteration %d again: %s", iteration, error)
            return None

    def _read(self, manifests: list[Manifest]) -> Collected:
        driven = self._within_cap(self._reader.read(manifests))
        rollout = driven.rollout
        begins = np.cumsum(rollout.lengths) - rollout.lengths
        rewards = np.add.reduceat(rollout.rewards, begins).tolist()
        lap_s = driven.duration_s[driven.completed].tolist()
        record = IterationRecord(
            iteration=manifests[0].iteration,
            checkpoint=str(min(checkpoint_name(m.checkpoint) for m in manifests)),
            episodes=len(rewards),
            steps=rollout.steps,
            total_steps=0,
            mean_reward=float(np.mean(rewards)),
            mean_progress=float(np.mean(driven.progress.tolist())),
            full_laps=len(lap_s),
            best_lap_s=min(lap_s, default=None),
            drive_s=max(m.notes.drive_s for m in manifests),
            elapsed_s=0.0,
            reward_errors=sum(m.notes.reward_errors for m in manifests),
            discarded=sum(m.notes.discarded for m in manifests),
        )
        return Collected(
            rollout,
            record,
            simulated_s=float(driven.duration_s.sum()),
            evaluates=next((n for m in manifests if (n := m.notes.evaluates) is not None), None),
            speeds={m.worker: m.steps / max(m.notes.drive_s, 1e-3) for m in manifests},
        )

    def _within_cap(self, driven: Episodes) -> Episodes:
        """The limit is for frames: episodes of a teacher have none."""
        if not driven.rollout.frames.size:
            return driven
        order = np.argsort(driven.numbers, kind="stable")
        fits = np.cumsum(driven.rollout.lengths[order]) <= self._max_steps
        fits[0] = True
        if fits.all():
            return driven
        _logger.warning(
            "Learning from %d of %d episodes: DR_TRAIN_MAX_STEPS_PER_ITERATION is %d steps.",
            fits.sum(),
            len(order),
            self._max_steps,
        )
        return driven.chosen(np.sort(order[fits]))
