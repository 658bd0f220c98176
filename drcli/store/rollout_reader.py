"""The trainer's side of rollouts: waits for the workers, reads what they drove."""

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from drcli.base.backoff import SLOW_GROWTH, delays_s
from drcli.base.json_record import RecordError
from drcli.exchange.rollout import Episodes, decode_episodes
from drcli.exchange.rollout_manifest import Manifest, Part, belongs
from drcli.store import keys
from drcli.store.bucket import Bucket, Listing, ObjectDamaged, ObjectMissing, read_record

PREFETCH_BYTES = 24 << 20
"""Most that is fetched ahead: three thousand steps. Longer iterations come while they unpack."""

FIRST_LOOK_S = 0.1
"""Pause between two looks for rollouts, at first. A look takes 7 ms, which the workers could be
driving in."""


@dataclass(frozen=True)
class Waiting:
    """Who waits for whom, and for how long.

    Args:
        iteration: Iteration whose rollouts are missing.
        missing: Workers that have not delivered theirs, in order.
        waited_s: Seconds since the wait began.
        gave_up: Whether this was the last look.
    """

    iteration: int
    missing: tuple[int, ...]
    waited_s: float
    gave_up: bool = False

    def __str__(self) -> str:
        who = ", ".join(str(worker) for worker in self.missing)
        end = "; going on without" if self.gave_up else ""
        return (
            f"The trainer has been waiting {self.waited_s:.0f} s for iteration {self.iteration} of "
            f"simulation worker {who}{end}."
        )


def find_manifest(bucket: Bucket, prefix: str, iteration: int, worker: int) -> Manifest | None:
    """What a worker has delivered; None where there is nothing yet, or it is damaged."""
    key = keys.rollout_manifest(prefix, iteration, worker)
    try:
        return read_record(bucket, key, Manifest.decode, "The worker drives the iteration again.")
    except (ObjectMissing, ObjectDamaged):
        return None


class RolloutReader:
    """Takes the rollouts of one model from the bucket. Close it when done.

    Args:
        bucket: Where they come.
        prefix: Of the model.
        session: Start of the training whose workers are waited for: what those of another start
            drove for this iteration, which may have had other weights, counts as missing. Of any
            start if empty.
        clock: Monotonic seconds, for tests.
        pause: Waits the given seconds, for tests.
    """

    def __init__(
        self,
        bucket: Bucket,
        prefix: str,
        session: str = "",
        *,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._session = session
        self._clock = clock
        self._pause = pause
        self._fetcher = ThreadPoolExecutor(2, thread_name_prefix="rollout-download")
        self._fetched: dict[str, Future[bytes]] = {}
        self._fetched_bytes = 0

    def wait_manifests(
        self,
        iteration: int,
        checkpoints: Collection[str],
        workers: Iterable[int],
        *,
        patience_s: float,
        enough: int | None = None,
        arrived: Mapping[int, Manifest] | None = None,
        on_wait: Callable[[Waiting], None] = lambda waiting: None,
        report_every_s: float = 10.0,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> dict[int, Manifest]:
        """Wait until the workers have delivered their rollouts, and fetch the parts that are there.

        Args:
            iteration: Which rollouts.
            checkpoints: Those that may have driven them; others are left over from a run that
                was stopped or went back, and count as missing.
            workers: Who drives.
            patience_s: After that long, go on with what is there.
            enough: Wait for no more than so many of them; for all when left out.
            arrived: Manifests that have come already.
            on_wait: Told who is missing, every `report_every_s` and when the patience ends.
            report_every_s: Seconds between two reports.
            should_stop: Asked at every look; ends the wait early.

        Returns:
            The manifests that came, by worker; all of them unless the wait was cut short.
        """
        wanted = sorted(workers)
        enough = len(wanted) if enough is None else enough
        known = dict(arrived or {})
        started_s = reported_s = self._clock()
        for delay_s in delays_s(FIRST_LOOK_S, growth=SLOW_GROWTH):
            self._look(iteration, checkpoints, wanted, known)
            missing = tuple(worker for worker in wanted if worker not in known)
            if len(known) >= enough or should_stop():
                break
            now_s = self._clock()
            waited_s = now_s - started_s
            if waited_s >= patience_s:
                on_wait(Waiting(iteration, missing, waited_s, gave_up=True))
                break
            if now_s - reported_s >= report_every_s:
                on_wait(Waiting(iteration, missing, waited_s))
                reported_s = now_s
            self._pause(min(delay_s, patience_s - waited_s))
        return dict(sorted(known.items()))

    def find_manifests(self, iteration: int, workers: Iterable[int]) -> list[Manifest]:
        """What some workers delivered for an iteration, whichever checkpoint drove it."""
        found = (find_manifest(self._bucket, self._prefix, iteration, k) for k in workers)
        return [manifest for manifest in found if manifest is not None]

    def iterations(self) -> list[int]:
        """Iterations of which there are rollouts, in order."""
        listing = self._bucket.list(keys.rollouts_folder(self._prefix))
        found = (keys.rollout_key(self._prefix, info.key) for info in listing)
        return sorted({key.iteration for key in found if key is not None})

    def read(self, manifests: Iterable[Manifest]) -> Episodes:
        """The episodes of some workers in one piece, each part checked against its manifest.

        Raises:
            ObjectMissing: A part is gone.
            ObjectDamaged: A part is not what the worker wrote.
        """
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
                f"{self._bucket.name}/{reading} is damaged: {e}.",
                remedy="Let the worker drive the iteration again; if it repeats, all machines need "
                "the same version of this program.",
            ) from e

    def _checked(self, manifest: Manifest, part: Part) -> bytes:
        data = self._take(part.key)
        fault = part.fingerprint.fault(data)
        if fault is not None:
            data = self._bucket.get(part.key)  # fetched too early, perhaps
            fault = part.fingerprint.fault(data)
        if fault is not None:
            raise ObjectDamaged(
                f"{self._bucket.name}/{part.key} is damaged: {fault}.",
                remedy=f"Simulation worker {manifest.worker} must drive iteration "
                f"{manifest.iteration} again.",
            )
        return data

    def delete_learned(self, iteration: int) -> None:
        """Delete the rollouts of this iteration and of all before it."""
        self._forget()
        doomed = []
        for info in self._bucket.list(keys.rollouts_folder(self._prefix)):
            key = keys.rollout_key(self._prefix, info.key)
            if key is not None and key.iteration <= iteration:
                doomed.append(info.key)
        self._bucket.delete(doomed)

    def reject(self, iteration: int, workers: Iterable[int]) -> None:
        """Delete what makes some workers' rollouts of an iteration count."""
        self._forget()
        self._bucket.delete([keys.rollout_manifest(self._prefix, iteration, k) for k in workers])

    def close(self) -> None:
        """End the background downloads."""
        self._forget()
        self._fetcher.shutdown(wait=True, cancel_futures=True)

    def _look(
        self,
        iteration: int,
        checkpoints: Collection[str],
        wanted: list[int],
        arrived: dict[int, Manifest],
    ) -> None:
        """Take manifests that have come, and begin to fetch parts that have."""
        listing = self._bucket.list(keys.iteration_folder(self._prefix, iteration))
        for worker in self._delivered_by(listing):
            if worker in wanted and worker not in arrived:
                manifest = find_manifest(self._bucket, self._prefix, iteration, worker)
                if (
                    manifest is not None
                    and manifest.checkpoint in checkpoints
                    and self._is_ours(manifest.session)
                ):
                    arrived[worker] = manifest
        for info in listing:
            key = keys.rollout_key(self._prefix, info.key)
            if key is not None and not key.is_manifest and self._is_ours(key.name):
                self._prefetch(info.key, info.size_bytes)

    def _is_ours(self, worker_session: str) -> bool:
        return not self._session or belongs(worker_session, self._session)

    def _delivered_by(self, listing: Listing) -> list[int]:
        found = (keys.rollout_key(self._prefix, info.key) for info in listing)
        return [key.worker for key in found if key is not None and key.is_manifest]

    def _prefetch(self, key: str, size_bytes: int) -> None:
        if key in self._fetched or self._fetched_bytes + size_bytes > PREFETCH_BYTES:
            return
        self._fetched_bytes += size_bytes
        self._fetched[key] = self._fetcher.submit(self._bucket.get, key)

    def _take(self, key: str) -> bytes:
        """What was fetched ahead, else fetched now."""
        early = self._fetched.pop(key, None)
        if early is None:
            return self._bucket.get(key)
        data = early.result()
        self._fetched_bytes -= len(data)
        return data

    def _forget(self) -> None:
        for early in self._fetched.values():
            early.cancel()
        self._fetched.clear()
        self._fetched_bytes = 0
