"""Rollouts in the bucket: a simulation worker writes them while it plays, the trainer takes them.

Parts come first, the manifest that names them last; a reader trusts nothing that no manifest of
the expected checkpoint confirms. Keys of parts carry the session of their writer, so a restarted
worker never overwrites what somebody may be reading.
"""

import json
import uuid
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from threading import BoundedSemaphore
from typing import Any

from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import Misfit, built, parsed
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.episode_encoding import LEAST_STEP_BYTES, Episodes, pack_episodes

_UNSENT_PARTS = 4
"""How many parts may wait in memory for a slow bucket before playing has to wait, too."""


@dataclass(frozen=True)
class Part:
    """One object with some of the episodes."""

    key: str
    fingerprint: Fingerprint
    episodes: int
    steps: int

    def __post_init__(self) -> None:
        """Refuse a part whose bytes cannot hold what it claims, before room is made for it.

        Raises:
            Misfit: They cannot.
        """
        if not 0 < self.episodes <= self.steps <= self.fingerprint.size_bytes / LEAST_STEP_BYTES:
            raise Misfit(
                f"{self.fingerprint.size_bytes} bytes cannot hold {self.episodes} episodes of "
                f"{self.steps} steps"
            )


@dataclass(frozen=True)
class Manifest:
    """What one worker played in one iteration.

    Args:
        iteration: Number of the checkpoint that drove.
        worker: Who played.
        checkpoint: Name of the checkpoint that drove.
        session: Start of the training, and of the worker in it, that wrote it.
        parts: Objects with the episodes, in the order they were played.
        notes: Free: results of the evaluation, time spent. Must be JSON.
    """

    iteration: int
    worker: int
    checkpoint: str
    session: str
    parts: tuple[Part, ...]
    notes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def episodes(self) -> int:
        """Number of episodes in all parts."""
        return sum(part.episodes for part in self.parts)

    @property
    def steps(self) -> int:
        """Number of steps in all parts."""
        return sum(part.steps for part in self.parts)

    def is_of(self, session: str) -> bool:
        """Whether a worker of this start of the training wrote it."""
        return belongs(self.session, session)

    def to_bytes(self) -> bytes:
        """The manifest as JSON."""
        return json.dumps(asdict(self), allow_nan=False).encode()

    @classmethod
    def from_bytes(cls, data: bytes, *, where: str = "a manifest") -> "Manifest":
        """Read a manifest.

        Raises:
            ObjectDamaged: The bytes are something else.
        """
        try:
            return built(cls, parsed(data))
        except Misfit as e:
            raise ObjectDamaged(
                f"{where} is damaged: {e}.",
                remedy="Delete it; the worker plays the iteration again.",
            ) from e


def session_of_worker(start: str, process: int, drive: int) -> str:
    """What a worker calls what it writes: no other drive of any start is called so.

    Args:
        start: Session of the training.
        process: Of the worker.
        drive: Counts its drives.
    """
    return f"{start}-{process}-{drive}"


def belongs(worker_session: str, start: str) -> bool:
    """Whether something was written by a worker of this start of a training."""
    return worker_session == start or worker_session.startswith(f"{start}-")


def new_session() -> str:
    """A name that no other start of a worker has."""
    return uuid.uuid4().hex[:12]


def find_manifest(bucket: Bucket, prefix: str, iteration: int, worker: int) -> Manifest | None:
    """What a worker has handed in already, None where it has not; damaged counts as not."""
    key = keys.rollout_manifest(prefix, iteration, worker)
    try:
        return Manifest.from_bytes(bucket.get(key), where=f"{bucket.name}/{key}")
    except (ObjectMissing, ObjectDamaged):
        return None


class RolloutWriter:
    """Sends the episodes of one worker and one iteration while it goes on playing.

    Leave it with `finish` or `abandon`.
    """

    def __init__(
        self,
        bucket: Bucket,
        prefix: str,
        *,
        iteration: int,
        worker: int,
        checkpoint: str,
        session: str,
    ) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._iteration = iteration
        self._worker = worker
        self._checkpoint = checkpoint
        self._session = session
        self._uploads: list[Future[Part]] = []
        self._sender = ThreadPoolExecutor(1, thread_name_prefix="rollout-upload")
        self._room = BoundedSemaphore(_UNSENT_PARTS)

    def add(self, episodes: Episodes) -> None:
        """Pack and send some whole episodes while the caller goes on; their arrays must stay.

        Raises:
            StorageError: An earlier part could not be sent.
        """
        self._raise_failure()
        self._room.acquire()
        self._uploads.append(self._sender.submit(self._send, len(self._uploads), episodes))

    def finish(self, notes: Mapping[str, Any] | None = None) -> Manifest:
        """Wait until everything is sent, then write the manifest, which makes it count.

        Raises:
            StorageError: Something could not be sent; nothing counts then.
        """
        self._sender.shutdown(wait=True)
        manifest = Manifest(
            self._iteration,
            self._worker,
            self._checkpoint,
            self._session,
            tuple(upload.result() for upload in self._uploads),
            dict(notes or {}),
        )
        key = keys.rollout_manifest(self._prefix, self._iteration, self._worker)
        self._bucket.put(key, manifest.to_bytes())
        return manifest

    def abandon(self) -> None:
        """Send nothing more and write no manifest; the trainer sweeps up what was sent."""
        self._sender.shutdown(wait=True, cancel_futures=True)

    def _send(self, number: int, episodes: Episodes) -> Part:
        try:
            data = pack_episodes(episodes)
            key = keys.rollout_part(
                self._prefix, self._iteration, self._worker, self._session, number
            )
            self._bucket.put(key, data)
            return Part(key, Fingerprint.of(data), episodes.count, episodes.steps)
        finally:
            self._room.release()

    def _raise_failure(self) -> None:
        for upload in self._uploads:
            if upload.done():
                upload.result()
