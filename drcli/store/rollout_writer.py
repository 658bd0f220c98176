"""Sends the episodes of a simulation worker to the bucket while it goes on driving.

The parts are written first, the manifest that names them last. Keys of parts contain the session of
their writer, so a restarted worker never overwrites a part that is being read.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from threading import BoundedSemaphore

from drcli.base.fingerprint import Fingerprint
from drcli.exchange.rollout import Episodes, encode_episodes
from drcli.exchange.rollout_manifest import Driving, Manifest, Part
from drcli.store import keys
from drcli.store.bucket import Bucket

_UNSENT_PARTS = 4
"""How many parts may wait in memory for a slow bucket before driving stops to wait."""


class RolloutWriter:
    """Sends the episodes of one worker in one iteration; end it with `finish` or `abandon`.

    The manifest has no parts yet.
    """

    def __init__(self, bucket: Bucket, prefix: str, manifest: Manifest) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._manifest = manifest
        self._uploads: list[Future[Part]] = []
        self._sender = ThreadPoolExecutor(1, thread_name_prefix="rollout-upload")
        self._room = BoundedSemaphore(_UNSENT_PARTS)

    def add(self, episodes: Episodes) -> None:
        """Send whole episodes in the background; their arrays must not change.

        Raises:
            StorageError: An earlier part could not be sent.
        """
        for upload in self._uploads:
            if upload.done():
                upload.result()
        self._room.acquire()
        self._uploads.append(self._sender.submit(self._send, len(self._uploads), episodes))

    def finish(self, notes: Driving) -> Manifest:
        """Wait until everything is sent, then write the manifest, from which readers start.

        Raises:
            StorageError: A part could not be sent; there is no manifest then.
        """
        self._sender.shutdown(wait=True)
        parts = tuple(upload.result() for upload in self._uploads)
        manifest = replace(self._manifest, parts=parts, notes=notes)
        key = keys.rollout_manifest(self._prefix, manifest.iteration, manifest.worker)
        self._bucket.put(key, manifest.encode())
        return manifest

    def abandon(self) -> None:
        """Stop without a manifest; the trainer deletes the parts."""
        self._sender.shutdown(wait=True, cancel_futures=True)

    def _send(self, number: int, episodes: Episodes) -> Part:
        try:
            data = encode_episodes(episodes)
            m = self._manifest
            key = keys.rollout_part(self._prefix, m.iteration, m.worker, m.session, number)
            self._bucket.put(key, data)
            return Part(key, Fingerprint.of(data), episodes.count, episodes.steps)
        finally:
            self._room.release()
