"""Who trains on a model prefix: the lease, how it is taken, and how writers see it is still theirs.

The lease is a record in the bucket that its owner writes again and again. It is not a lock: nothing
waits for it, and one that was not renewed for a minute means nothing. So another machine may take
the prefix over while its owner is only held up (stopped, asleep, without network). Whoever writes
therefore reads the lease first, and ends when it is somebody else's. Nothing depends on conditional
writes, which not all S3 servers know, nor on the clocks of two machines agreeing: only the server's
clock tells how old the lease is. How it is renewed: `drcli.runs.lease_renewal`.
"""

import os
import socket
import time
from collections.abc import Callable
from dataclasses import replace

from drcli.base.errors import OwnershipLost, SettingsError
from drcli.base.json_record import RecordError
from drcli.base.process_identity import is_alive, started_s, this_machine
from drcli.exchange.run_state import Lease
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

STALE_S = 60.0
"""Age after which a lease means nothing. Its owner renews it every ten seconds."""

POINTER_TRUSTED_S = 0.1
"""How long what was read of the lease is believed before a pointer is written: two in a row need
one look."""

OTHERS_TRUSTED_S = 1.0
"""The same before other objects (`keys.decides`). A new owner's processes take longer to start."""


def read_lease(bucket: Bucket, prefix: str) -> Lease | None:
    """The lease, however old; None where there is none that can be read."""
    try:
        data, age_s = bucket.get_with_age(keys.lease(prefix))
        lease = Lease.decode(data)
    except (ObjectMissing, RecordError):
        return None
    return replace(lease, age_s=time.time() - lease.renewed if age_s is None else age_s)


def write_lease(bucket: Bucket, prefix: str, lease: Lease) -> None:
    """Write the lease."""
    bucket.put(keys.lease(prefix), lease.encode())


def holder(bucket: Bucket, prefix: str) -> Lease | None:
    """Who trains on the prefix now; None where nobody does, or the lease is too old."""
    lease = read_lease(bucket, prefix)
    if lease is None or lease.released or lease.age_s >= STALE_S:
        return None
    return lease


def refuse_other_owner(bucket: Bucket, prefix: str, session: str = "") -> None:
    """Refuse a prefix that is trained on from another folder or machine.

    Args:
        bucket: Holds the lease.
        prefix: Where somebody wants to train.
        session: The start that asks; its own lease does not count.

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
    """Whether the owner may still run; of another machine's owner, that is assumed."""
    if lease.machine != this_machine():
        return True
    return is_alive(lease.pid, lease.pid_started)


def take(bucket: Bucket, prefix: str, session: str) -> Lease:
    """Make this process the owner of the prefix, whoever was before.

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


def elapsed_s() -> float:
    """A clock for how long this process was held up: it also counts a suspended machine."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


def lost_to(bucket: Bucket, prefix: str, lease: Lease) -> OwnershipLost:
    """The failure of a start that has lost the prefix to another."""
    is_or_was = "was" if lease.released else "is"
    return OwnershipLost(
        f"s3://{bucket.name}/{prefix} {is_or_was} trained by process {lease.pid} on {lease.host}, "
        "which took over after nothing had been heard from this training for a minute. Anything it "
        "did since then is discarded.",
        remedy="Nothing is lost; the other training goes on. To go on here, stop it there, then "
        "`dr-start-training --resume`.",
    )


class Ownership:
    """Tells a process of a training whether the prefix is still its own. For several threads.

    Args:
        bucket: Holds the lease.
        prefix: Of the model.
        session: The start that this process belongs to.
        term: Of its lease, as far as that is known.
        clock: Seconds that go on while this process is stopped, for tests.
    """

    def __init__(
        self,
        bucket: Bucket,
        prefix: str,
        session: str,
        term: int = 0,
        *,
        clock: Callable[[], float] = elapsed_s,
    ) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._session = session
        self._clock = clock
        self._term = term
        self._read_s = -OTHERS_TRUSTED_S

    def check(self, key: str) -> None:
        """Return while the prefix is this start's own; called before everything that is written.

        A lease that is missing or damaged is not another owner's: the supervisor writes it again.

        Args:
            key: What is to be written or deleted.

        Raises:
            OwnershipLost: It is somebody else's.
            StorageError: The lease cannot be read.
        """
        began_s = self._clock()
        if began_s - self._read_s < (POINTER_TRUSTED_S if keys.decides(key) else OTHERS_TRUSTED_S):
            return
        lease = read_lease(self._bucket, self._prefix)
        if lease is not None and lease.outranks(self._session, self._term):
            raise lost_to(self._bucket, self._prefix, lease)
        if lease is not None and lease.session == self._session:
            self._term = lease.term
        self._read_s = began_s
