"""The rollouts of simulation workers: waits for them, collects them for the learner, sends them."""

import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from threading import BoundedSemaphore
from types import MappingProxyType

import numpy as np

from drcli.base.clock import SLOW_GROWTH, delays_s
from drcli.base.json_record import Fingerprint, RecordError
from drcli.base.log import get_logger
from drcli.bucket.bucket import (
    READS,
    READS_FAR,
    ObjectDamaged,
    ObjectInfo,
    ObjectMissing,
    find_record,
)
from drcli.learn.rollout_buffer import Rollout
from drcli.model import keys
from drcli.model.keys import RolloutKey
from drcli.model.model_store import ModelStore
from drcli.model.training_state import NO_ROLLBACKS, Rollbacks
from drcli.records.checkpoint import checkpoint_name
from drcli.records.iteration import IterationRecord
from drcli.records.job import WorkerShare
from drcli.records.rollout import (
    Driving,
    Episodes,
    Manifest,
    Part,
    belongs,
    decode_episodes,
    encode_episodes,
)

_logger = get_logger(__name__)

PREFETCH_BYTES = 24 << 20
"""Three thousand steps."""

FIRST_LOOK_S, WOKEN_LOOK_S = 0.1, 0.5
"""First pause between two looks for rollouts: in any case, and for a trainer that its workers wake.
A look takes 7 ms of the workers' time."""

QUIET_SHARE, REMEMBERED = 0.7, 5
"""Share of the shortest of the last waits in which a frugal reader does not look. After that, it
asks for manifests: to list a folder costs twelve times as much as to read an object."""

LATE_SHARE = 0.05
QUIET_STEP_S = 1.0
REPORT_EVERY_S = 10.0


def find_manifest(model: ModelStore, iteration: int, worker: int) -> Manifest | None:
    """None if missing or damaged."""
    key = keys.rollout_manifest(model.prefix, iteration, worker)
    with suppress(ObjectDamaged):
        return find_record(model.bucket, key, Manifest.decode)
    return None


class RolloutReader:
    """Reads the rollouts of one model. Close it when done.

    Rollouts of another `session` (if not empty), or with weights given up in `rollbacks`, count as
    missing. A `frugal` one, for a bucket elsewhere, looks less often. `pause` returns True if
    woken; the first lasts `first_look_s`.
    """

    def __init__(
        self,
        model: ModelStore,
        session: str = "",
        *,
        frugal: bool = False,
        rollbacks: Rollbacks = NO_ROLLBACKS,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], bool | None] = time.sleep,
        first_look_s: float = FIRST_LOOK_S,
    ) -> None:
        self._frugal = frugal
        self._rollbacks = rollbacks
        self._waits_s: deque[float] = deque(maxlen=REMEMBERED)
        self._model = model
        self._session = session
        self._clock = clock
        self._pause = pause
        self._first_look_s = first_look_s
        threads = READS_FAR if frugal else READS
        self._fetcher = ThreadPoolExecutor(threads, thread_name_prefix="rollout-download")
        self._fetched: dict[str, Future[bytes]] = {}
        self._fetched_bytes = 0

    def wait_manifests(
        self,
        iteration: int,
        checkpoints: Collection[str],
        workers: Collection[int],
        *,
        enough: int,
        arrived: Mapping[int, Manifest] = MappingProxyType({}),
        should_stop: Callable[[], bool] = lambda: False,
        is_over: Callable[[Mapping[int, Manifest], float], bool] = lambda arrived, waited_s: False,
    ) -> dict[int, Manifest]:
        """Wait for the workers' rollouts, and fetch parts that have come.

        Rollouts of other than `checkpoints`, of a stopped or rolled-back run, count as missing. It
        ends with `enough` manifests; each look asks `should_stop` and `is_over`, with the manifests
        and seconds so far. The log says every `REPORT_EVERY_S`, and at the end, who is missing.

        Returns:
            The manifests, by worker.
        """
        known = dict(arrived)
        started_s = reported_s = self._clock()
        quiet_s = 0.0 if arrived else self._quiet_s()
        first_s = max(self._first_look_s, LATE_SHARE * quiet_s / QUIET_SHARE)
        lists = True
        for delay_s in delays_s(first_s, growth=SLOW_GROWTH):
            missing = sorted(set(workers) - known.keys())
            # Without a listing: cheaper for up to twelve workers.
            asked = self._delivered(iteration, missing) if lists or not self._frugal else missing
            known |= self._found(iteration, checkpoints, asked)
            lists = False
            if len(known) >= enough:
                if not arrived:
                    self._waits_s.append(self._clock() - started_s)
                break
            if should_stop():
                break
            now_s = self._clock()
            waited_s = now_s - started_s
            if waited_s < quiet_s:
                self._keep_quiet(started_s + quiet_s, should_stop)
                quiet_s, lists = 0.0, True  # most parts are there now, and can be fetched
                continue
            names = ", ".join(map(str, sorted(set(workers) - known.keys())))
            waiting = (
                f"The trainer has been waiting {waited_s:.0f} s for iteration {iteration} of "
                f"simulation worker {names}"
            )
            if is_over(known, waited_s):
                _logger.info("%s; going on without.", waiting)
                break
            if now_s - reported_s >= REPORT_EVERY_S:
                _logger.info("%s.", waiting)
                reported_s = now_s
            self._pause(delay_s)
        return dict(sorted(known.items()))

    def _quiet_s(self) -> float:
        if not self._frugal or len(self._waits_s) < 2:
            return 0.0
        return QUIET_SHARE * min(self._waits_s)

    def _keep_quiet(self, until_s: float, should_stop: Callable[[], bool]) -> None:
        while (left_s := until_s - self._clock()) > 0.0 and not should_stop():
            if self._pause(min(left_s, QUIET_STEP_S)):
                return

    def find_manifests(self, iteration: int) -> list[Manifest]:
        listed = self._listed(keys.iteration_folder(self._model.prefix, iteration))
        workers = sorted(key.worker for _, key in listed if key.is_manifest)
        found = (find_manifest(self._model, iteration, k) for k in workers)
        return [each for each in found if each is not None and self._counts(each)]

    def iterations(self) -> list[int]:
        listed = self._listed(keys.rollouts_folder(self._model.prefix))
        return sorted({key.iteration for _, key in listed})

    def read(self, manifests: Iterable[Manifest]) -> Episodes:
        wanted = [(manifest, part) for manifest in manifests for part in manifest.parts]
        reading = ""

        def each() -> Iterator[bytes]:
            nonlocal reading
            for number, (manifest, part) in enumerate(wanted):
                reading = part.key
                for _, later in wanted[number:]:
                    self._prefetch(later.key, later.fingerprint.size_bytes)
                yield self._checked(manifest, part)

        try:
            return decode_episodes(each(), sum(part.steps for _, part in wanted))
        except RecordError as e:
            raise ObjectDamaged(
                f"{self._model.bucket.name}/{reading} is damaged: {e}.",
                remedy="Let the worker drive the iteration again; if it happens again, install the "
                "same version of this program on all machines.",
            ) from e

    def _checked(self, manifest: Manifest, part: Part) -> bytes:
        data = self._take(part.key)
        fault = part.fingerprint.fault(data)
        if fault is not None:
            data = self._model.bucket.get(part.key)  # maybe it was fetched too early
            fault = part.fingerprint.fault(data)
        if fault is not None:
            raise ObjectDamaged(
                f"{self._model.bucket.name}/{part.key} is damaged: {fault}.",
                remedy=f"Simulation worker {manifest.worker} must drive iteration "
                f"{manifest.iteration} again.",
            )
        return data

    def delete_learned(self, iteration: int) -> None:
        listed = self._listed(keys.rollouts_folder(self._model.prefix))
        self._model.bucket.delete([info.key for info, key in listed if key.iteration <= iteration])

    def reject(self, iteration: int, workers: Iterable[int]) -> None:
        """These must be driven again."""
        self.forget()
        self._model.bucket.delete(
            [keys.rollout_manifest(self._model.prefix, iteration, k) for k in workers]
        )

    def look_often(self) -> None:
        """For workers elsewhere, which cannot wake it."""
        self._first_look_s = FIRST_LOOK_S

    def close(self) -> None:
        self.forget()
        self._fetcher.shutdown(wait=True, cancel_futures=True)

    def _listed(self, folder: str) -> Iterator[tuple[ObjectInfo, RolloutKey]]:
        for info in self._model.bucket.list(folder):
            key = keys.rollout_key(self._model.prefix, info.key)
            if key is not None:
                yield info, key

    def _delivered(self, iteration: int, missing: Collection[int]) -> list[int]:
        """Which of these workers have a manifest; begins to fetch parts."""
        delivered = []
        for info, key in self._listed(keys.iteration_folder(self._model.prefix, iteration)):
            if key.is_manifest:
                delivered += [key.worker] if key.worker in missing else []
            elif self._is_ours(key.name):
                self._prefetch(info.key, info.size_bytes)
        return delivered

    def _found(
        self, iteration: int, checkpoints: Collection[str], workers: Collection[int]
    ) -> dict[int, Manifest]:
        find = partial(find_manifest, self._model, iteration)
        # Each takes a round trip to the bucket, so those of many workers are read together.
        together = len(workers) > 1 and self._frugal
        found = self._fetcher.map(find, workers) if together else map(find, workers)
        return {
            worker: manifest
            for worker, manifest in zip(workers, found, strict=True)
            if manifest is not None
            and manifest.checkpoint in checkpoints
            and self._is_ours(manifest.session)
            and self._counts(manifest)
        }

    def _counts(self, manifest: Manifest) -> bool:
        number = checkpoint_name(manifest.checkpoint).number
        return self._rollbacks.allows(number, manifest.rollbacks)

    def _is_ours(self, worker_session: str) -> bool:
        return not self._session or belongs(worker_session, self._session)

    def _prefetch(self, key: str, size_bytes: int) -> None:
        if key in self._fetched or self._fetched_bytes + size_bytes > PREFETCH_BYTES:
            return
        self._fetched_bytes += size_bytes
        self._fetched[key] = self._fetcher.submit(self._model.bucket.get, key)

    def _take(self, key: str) -> bytes:
        early = self._fetched.pop(key, None)
        if early is None:
            return self._model.bucket.get(key)
        data = early.result()
        self._fetched_bytes -= len(data)
        return data

    def forget(self) -> None:
        for early in self._fetched.values():
            early.cancel()
        self._fetched.clear()
        self._fetched_bytes = 0


# Collects the rollouts of all simulation workers for the learner.


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


# Sends a worker's episodes to the bucket while it drives on.
#
# Parts first, then the manifest that names them. Their keys have the session, so a restarted
# worker never overwrites a part that is read.


_UNSENT_PARTS = 4
"""Then driving waits for a slow bucket."""


class RolloutWriter:
    """One worker and iteration; end it with `finish` or `abandon`.

    `manifest` has no parts yet.
    """

    def __init__(self, model: ModelStore, manifest: Manifest) -> None:
        self._model = model
        self._manifest = manifest
        self._uploads: list[Future[Part]] = []
        self._sender = ThreadPoolExecutor(1, thread_name_prefix="rollout-upload")
        self._room = BoundedSemaphore(_UNSENT_PARTS)

    def add(self, episodes: Episodes) -> None:
        """Send in the background; arrays must not change.

        Raises:
            StorageError: An earlier part could not be sent.
        """
        for upload in self._uploads:
            if upload.done():
                upload.result()
        self._room.acquire()
        self._uploads.append(self._sender.submit(self._send, len(self._uploads), episodes))

    def finish(self, notes: Driving) -> Manifest:
        """Wait, then write the manifest.

        Raises:
            StorageError: A part could not be sent, so there is none.
        """
        self._sender.shutdown(wait=True)
        parts = tuple(upload.result() for upload in self._uploads)
        manifest = replace(self._manifest, parts=parts, notes=notes)
        key = keys.rollout_manifest(self._model.prefix, manifest.iteration, manifest.worker)
        self._model.bucket.put(key, manifest.encode())
        return manifest

    def abandon(self) -> None:
        """The trainer deletes the parts."""
        self._sender.shutdown(wait=True, cancel_futures=True)

    def _send(self, number: int, episodes: Episodes) -> Part:
        try:
            data = encode_episodes(episodes)
            m = self._manifest
            key = keys.rollout_part(self._model.prefix, m.iteration, m.worker, m.session, number)
            self._model.bucket.put(key, data)
            return Part(key, Fingerprint.of(data), episodes.count, episodes.steps)
        finally:
            self._room.release()
