"""The lease says who trains on a model prefix: how it is taken, and how writers check it.

The lease is a record in the bucket that its owner renews often (`drcli.runs.lease_renewal`). It is
not a lock: nothing waits for it, and after a minute without renewal it has expired. Another machine
may then take the prefix although the owner is only suspended or without network. So every writer
reads the lease first, and ends if it has another owner. This needs no conditional writes, which not
all S3 servers know, and no equal clocks: the age of the lease comes from the server's clock.
"""

import os
import socket
import time
from collections.abc import Callable
from dataclasses import replace

from drcli.base.elapsed import elapsed_s
from drcli.base.errors import OwnershipLost, SettingsError
from drcli.base.json_record import NewerFormat, RecordError
from drcli.base.process_identity import is_alive, started_s, this_machine
from drcli.exchange.run_state import Lease
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

STALE_S = 60.0
"""Age at which a lease has expired. Its owner renews it every ten seconds."""

POINTER_TRUSTED_S = 0.1
"""How long a read lease is valid before a pointer is written: two in a row need one read."""

OTHERS_TRUSTED_S = 1.0
"""The same before other objects (`keys.decides`). A new owner's processes take longer to start."""


class ModelInUse(SettingsError):
    """Another start trains the model, or had trained it until a moment ago."""


def read_lease(bucket: Bucket, prefix: str) -> Lease | None:
    """The lease of the training on a prefix, as `read_lease_at`."""
    return read_lease_at(bucket, keys.lease(prefix))


def read_lease_at(bucket: Bucket, key: str) -> Lease | None:
    """The lease of this key, however old; None if it does not exist or is damaged.

    Of the lease of a newer drcli, only `newer` is known.
    """
    try:
        data, age_s = bucket.get_with_age(key)
        lease = Lease.decode(data)
    except NewerFormat:
        return Lease.of_newer()
    except (ObjectMissing, RecordError):
        return None
    return replace(lease, age_s=time.time() - lease.renewed if age_s is None else age_s)


def write_lease(bucket: Bucket, prefix: str, lease: Lease) -> None:
    """Write the lease."""
    bucket.put(keys.lease(prefix), lease.encode())


def holder(bucket: Bucket, prefix: str) -> Lease | None:
    """The lease of the training on the prefix; None if there is none, or it has expired.

    The lease of a newer drcli never expires: its owner would not recognise a lease of ours.
    """
    lease = read_lease(bucket, prefix)
    if lease is not None and lease.newer:
        return lease
    if lease is None or lease.released or lease.age_s >= STALE_S:
        return None
    return lease


def live_holder(bucket: Bucket, prefix: str) -> Lease | None:
    """The lease of the training on the prefix; None if there is none, or its owner has ended."""
    held = holder(bucket, prefix)
    return held if held is not None and is_owner_alive(held) else None


def refuse_other_owner(bucket: Bucket, prefix: str, session: str = "") -> None:
    """Return if no start other than this session trains on the prefix.

    Raises:
        ModelInUse: One does.
        SettingsError: The owner is a newer version of drcli.
    """
    held = live_holder(bucket, prefix)
    if held is None or held.session == session:
        return
    if held.newer:
        raise _owned_by_newer(bucket, prefix)
    raise ModelInUse(
        f"s3://{bucket.name}/{prefix} is being trained by {held.owner} "
        f"(last heard from {max(0.0, held.age_s):.0f} s ago).",
        remedy="Stop that training, or choose another DR_LOCAL_S3_MODEL_PREFIX. If that machine "
        f"is gone, try again in {STALE_S:.0f} seconds.",
    )


def _owned_by_newer(bucket: Bucket, prefix: str) -> SettingsError:
    return SettingsError(
        f"s3://{bucket.name}/{prefix} is or was trained by a newer version of drcli, whose lock "
        "this version cannot read.",
        remedy="Update drcli on this machine, or choose another DR_LOCAL_S3_MODEL_PREFIX.",
    )


def is_owner_alive(lease: Lease) -> bool:
    """Whether the owner may still run; on another machine, this is assumed."""
    return lease.newer or lease.machine != this_machine() or is_alive(lease.pid, lease.pid_started)


def take(bucket: Bucket, prefix: str, session: str) -> Lease:
    """Make this process the owner of the prefix; the lease must then be renewed.

    Raises:
        SettingsError: The prefix belongs to a newer version of drcli.
    """
    before = read_lease(bucket, prefix)
    if before is not None and before.newer:
        raise _owned_by_newer(bucket, prefix)
    term = 1 if before is None else before.term + (before.session != session)
    lease = Lease(
        session=session,
        host=socket.gethostname(),
        pid=os.getpid(),
        renewed=time.time(),
        machine=this_machine(),
        pid_started=started_s(os.getpid()) or 0.0,
        term=term,
    )
    write_lease(bucket, prefix, lease)
    return lease


def release(bucket: Bucket, prefix: str, session: str) -> None:
    """Release the prefix if this session is its owner."""
    lease = read_lease(bucket, prefix)
    if lease is not None and lease.session == session and not lease.released:
        write_lease(bucket, prefix, replace(lease, released=True, renewed=time.time()))


def lost_to(bucket: Bucket, prefix: str, lease: Lease) -> OwnershipLost:
    """The error of a start that has lost the prefix to another one."""
    is_or_was = "was" if lease.released else "is"
    return OwnershipLost(
        f"s3://{bucket.name}/{prefix} {is_or_was} trained by {lease.owner}, "
        "which took over because this training had not renewed its lock for a minute. Everything "
        "this training did after that is discarded.",
        remedy="The model is safe; the other training continues. To continue here, stop the other "
        "training, then run `dr-start-training --resume` here.",
    )


class Ownership:
    """Checks for a process of a training that the prefix is still its own. For several threads.

    Args:
        bucket: Contains the lease.
        prefix: Of the model.
        session: Of the start that this process belongs to.
        term: Of its lease; 0 if unknown.
        trainer: As in `Job`.
        trusted_s: How long a read lease is valid before a pointer is written.
        clock: Seconds that also pass while this process is suspended, for tests.
    """

    def __init__(
        self,
        bucket: Bucket,
        prefix: str,
        session: str,
        term: int = 0,
        *,
        trainer: int | None = None,
        trusted_s: float = POINTER_TRUSTED_S,
        clock: Callable[[], float] = elapsed_s,
    ) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._session = session
        self._trusted_s = trusted_s
        self._clock = clock
        self._term = term
        self._trainer = trainer
        self._read_s = -OTHERS_TRUSTED_S

    def check(self, key: str) -> None:
        """Return if the prefix still belongs to this start; called before `key` is written.

        A missing or damaged lease is no problem: the supervisor writes it again.

        Raises:
            OwnershipLost: The prefix belongs to another start, or another process of this start is
                its trainer now.
            StorageError: The lease cannot be read.
        """
        began_s = self._clock()
        if began_s - self._read_s < (self._trusted_s if keys.decides(key) else OTHERS_TRUSTED_S):
            return
        lease = read_lease(self._bucket, self._prefix)
        if lease is not None and lease.outranks(self._session, self._term):
            raise lost_to(self._bucket, self._prefix, lease)
        if lease is not None and lease.session == self._session:
            self._term = lease.term
            if self._trainer is not None and lease.trainer > self._trainer:
                raise OwnershipLost(
                    "Another process is the trainer now, because this one could not be reached.",
                    remedy="The training goes on there; nothing is to be done.",
                )
        self._read_s = began_s
