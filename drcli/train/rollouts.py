"""Waits for the workers' rollouts and reads them."""

import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from threading import BoundedSemaphore
from types import MappingProxyType

from drcli.base.clock import SLOW_GROWTH, delays_s
from drcli.base.json_record import Fingerprint, RecordError
from drcli.base.log import get_logger
from drcli.bucket.bucket import READS, READS_FAR, ObjectDamaged, ObjectInfo, find_record
from drcli.model import keys
from drcli.model.keys import RolloutKey
from drcli.model.model_store import ModelStore
from drcli.model.training_state import NO_ROLLBACKS, Rollbacks
from drcli.records.checkpoint import checkpoint_name
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
