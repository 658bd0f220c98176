"""Lets one process of all machines drive a race's queue.

As the lease of a training (`store.lease`): expires a minute after its last renewal; needs
neither conditional writes nor equal clocks.
"""

import os
import secrets
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from drcli.base.errors import OwnershipLost, SettingsError, StorageError
from drcli.base.processes import started_s, this_machine
from drcli.bucket.bucket import Bucket
from drcli.model import race_keys
from drcli.model.lease import STALE_S, is_owner_alive, read_lease_at
from drcli.races.standings import NOBODY, Runner
from drcli.records.run_record import Lease

RENEW_S = 10.0


class QueueLease:
    def __init__(self, bucket: Bucket, race: str, lease: Lease) -> None:
        self._bucket = bucket
        self._race = race
        self._lease = lease
        self.session = lease.session

    def check(self) -> None:
        """Call before each write.

        Raises:
            OwnershipLost: Another process drives the queue.
        """
        found = read_queue_lease(self._bucket, self._race)
        if found is not None and found.outranks(self.session, self._lease.term):
            raise OwnershipLost(
                f"The queue of race {self._race} is driven by {found.owner}, which took over "
                "because this process had not renewed its lock for a minute.",
                remedy="Nothing is lost: the other process drives what is left.",
            )

    def renew(self) -> None:
        found = read_queue_lease(self._bucket, self._race)
        if found is None or not found.outranks(self.session, self._lease.term):
            self._write(self._lease)

    def release(self) -> None:
        found = read_queue_lease(self._bucket, self._race)
        if found is not None and found.session == self.session:
            self._write(replace(self._lease, released=True))

    def _write(self, lease: Lease) -> None:
        record = replace(lease, renewed=time.time())
        self._bucket.put(race_keys.lease(self._race), record.encode())


def read_queue_lease(bucket: Bucket, race: str) -> Lease | None:
    """However old; None without a readable one."""
    return read_lease_at(bucket, race_keys.lease(race))


def live_lease(bucket: Bucket, race: str) -> Lease | None:
    lease = read_queue_lease(bucket, race)
    if lease is None or lease.newer:
        return lease
    if lease.released or lease.age_s >= STALE_S or not is_owner_alive(lease):
        return None
    return lease


def runner_of(bucket: Bucket, race: str) -> Runner:
    lease = live_lease(bucket, race)
    return NOBODY if lease is None else Runner(lease.session, lease.owner)


@contextmanager
def held(bucket: Bucket, race: str) -> Iterator[QueueLease]:
    """Own the queue inside the `with` block; raises SettingsError if another process does."""
    holder = live_lease(bucket, race)
    if holder is not None:
        raise SettingsError(
            f"The queue of race {race} is being driven by {holder.owner}.",
            remedy=f"Watch it with `dr-race show {race}`, or stop it there with `dr-race stop "
            f"{race}`. If that machine is gone, try again in {STALE_S:.0f} seconds.",
        )
    before = read_queue_lease(bucket, race)
    lease = QueueLease(
        bucket,
        race,
        Lease(
            session=secrets.token_hex(6),
            host=socket.gethostname(),
            pid=os.getpid(),
            renewed=time.time(),
            machine=this_machine(),
            pid_started=started_s(os.getpid()) or 0.0,
            term=1 if before is None else before.term + 1,
        ),
    )
    lease.renew()
    ended = threading.Event()

    def keep() -> None:
        while not ended.wait(RENEW_S):
            with suppress(StorageError):  # the next time, perhaps; after a minute another may come
                lease.renew()

    keeper = threading.Thread(target=keep, name="queue-lease", daemon=True)
    keeper.start()
    try:
        lease.check()
        yield lease
    finally:
        ended.set()
        keeper.join(RENEW_S)
        with suppress(StorageError):
            lease.release()
