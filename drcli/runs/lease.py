"""Who trains on a model prefix: a note in the bucket that its owner renews.

It is no lock: nothing waits for it, and a note that is not renewed means nothing after a minute,
so a machine that vanishes leaves nothing behind that somebody has to remove.
"""

import json
import os
import socket
import time
from dataclasses import asdict, dataclass

from drcli.errors import SettingsError
from drcli.jsonrecord import Misfit, built, parsed
from drcli.runs.record import exists
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

STALE_S = 60.0
"""Age after which a note means nothing. Its owner renews it every ten seconds."""


@dataclass(frozen=True)
class Lease:
    """The note.

    Attributes:
        session: Unique name of the start that owns the prefix.
        host: Its machine.
        pid: Its supervisor there.
        renewed: Unix seconds.
    """

    session: str
    host: str
    pid: int
    renewed: float


def holder(bucket: Bucket, prefix: str) -> Lease | None:
    """Who trains on the prefix now, or None; a note that says nothing is as good as a stale one."""
    try:
        lease = built(Lease, parsed(bucket.get(keys.lease(prefix))))
        return lease if time.time() - lease.renewed < STALE_S else None
    except (ObjectMissing, Misfit):
        return None


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
        f"{held.host} (last heard of {time.time() - held.renewed:.0f} s ago).",
        remedy="Stop that training, or choose another DR_LOCAL_S3_MODEL_PREFIX. If that machine "
        f"is gone, try again in {STALE_S:.0f} seconds.",
    )


def is_owner_alive(lease: Lease) -> bool:
    """Whether the owner may still be at work: on this machine we can look, elsewhere we believe."""
    return lease.host != socket.gethostname() or exists(lease.pid)


def renew(bucket: Bucket, prefix: str, session: str) -> None:
    """Say that this process trains on the prefix."""
    lease = Lease(session, socket.gethostname(), os.getpid(), time.time())
    bucket.put(keys.lease(prefix), json.dumps(asdict(lease)).encode())


def release(bucket: Bucket, prefix: str, session: str) -> None:
    """Take the note back, if it is this session's."""
    lease = holder(bucket, prefix)
    if lease is not None and lease.session == session:
        bucket.delete([keys.lease(prefix)])
