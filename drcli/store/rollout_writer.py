"""Sends a worker's episodes to the bucket while it drives on.

Parts first, then the manifest that names them. Their keys have the session, so a restarted worker
never overwrites a part that is read.
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
"""Then driving waits for a slow bucket."""


class RolloutWriter:
    """One worker and iteration; end it with `finish` or `abandon`.

    `manifest` has no parts yet.
    """

    def __init__(self, bucket: Bucket, prefix: str, manifest: Manifest) -> None:
        self._bucket = bucket
        self._prefix = prefix
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
        key = keys.rollout_manifest(self._prefix, manifest.iteration, manifest.worker)
        self._bucket.put(key, manifest.encode())
        return manifest

    def abandon(self) -> None:
        """The trainer deletes the parts."""
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
