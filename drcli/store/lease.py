"""Takes a model prefix for a start, gives it back, and refuses one that somebody else trains on.

What the lease is and how it is read: `drcli.store.ownership`. How it is kept:
`drcli.runs.lease_renewal`.
"""

import os
import socket
import time
from dataclasses import replace

from drcli.base.errors import SettingsError
from drcli.base.process_identity import is_alive, started_s, this_machine
from drcli.store.bucket import Bucket
from drcli.store.ownership import Lease, read_lease, write_lease

STALE_S = 60.0
"""Age after which a lease means nothing. Its owner renews it every ten seconds."""


def holder(bucket: Bucket, prefix: str) -> Lease | None:
    """Who trains on the prefix now, or None; a note that says nothing is as good as a stale one."""
    lease = read_lease(bucket, prefix)
    if lease is None or lease.released or lease.age_s >= STALE_S:
        return None
    return lease


def refuse_other_owner(bucket: Bucket, prefix: str, session: str = "") -> None:
    """Refuse a prefix that is trained on from another folder or machine.

    Args:
        bucket: Holds the note.
        prefix: Where somebody wants to train.
        session: The start that asks, whose own note is no obstacle.

    Raises:
        SettingsError: It is.
    """
    held = holder(bucket, prefix)
    if held is None or held.session == session or not is_owner_alive(held):
        return
    raise SettingsError(
        f"s3://{bucket.name}/{prefix} is being trained by process {held.pid} on "
        f"{held.host} (last heard of {held.age_s:.0f} s ago).",
        remedy="Stop that training, or choose another DR_LOCAL_S3_MODEL_PREFIX. If that machine "
        f"is gone, try again in {STALE_S:.0f} seconds.",
    )


def is_owner_alive(lease: Lease) -> bool:
    """Whether the owner may still be at work: on this machine we can look, elsewhere we believe."""
    if lease.machine != this_machine():
        return True
    return is_alive(lease.pid, lease.pid_started)


def take(bucket: Bucket, prefix: str, session: str) -> Lease:
    """Say that this process trains on the prefix from now on, whoever did before.

    Returns:
        The lease, to be renewed.
    """
    before = read_lease(bucket, prefix)
    term = 1
    if before is not None:
        term = before.term if before.session == session else before.term + 1
    pid = os.getpid()
    lease = Lease(
        session=session,
        host=socket.gethostname(),
        pid=pid,
        renewed=time.time(),
        machine=this_machine(),
        pid_started=started_s(pid) or 0.0,
        term=term,
    )
    write_lease(bucket, prefix, lease)
    return lease


def release(bucket: Bucket, prefix: str, session: str) -> None:
    """Give the prefix back, if it is this session's."""
    lease = read_lease(bucket, prefix)
    if lease is not None and lease.session == session and not lease.released:
        write_lease(bucket, prefix, replace(lease, released=True, renewed=time.time()))
