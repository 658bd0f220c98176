"""Who trains on a model prefix: how the lease is taken, and how writers check it.

The owner renews this record often (`run/interruption_watch`). Nothing waits for it: it is not a
lock. After a minute it expires, and another machine may take the prefix, though the owner may only
be suspended. So every writer reads it first, and ends if it lost. This needs neither conditional
writes, which not all S3 servers know, nor equal clocks: its age is by the server's.
"""

import os
import socket
import time
from collections.abc import Callable
from dataclasses import replace

from drcli.base.clock import elapsed_s
from drcli.base.errors import OwnershipLost, SettingsError
from drcli.base.json_record import NewerFormat, RecordError
from drcli.base.processes import is_alive, started_s, this_machine
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.run_record import Lease

STALE_S = 60.0
"""Its owner renews it every ten seconds."""

POINTER_TRUSTED_S = 0.1
"""How long a read lease is valid before a pointer; two in a row need one read."""

OTHERS_TRUSTED_S = 1.0
"""Before other objects (`keys.decides`): a new owner takes longer to start."""


class ModelInUse(SettingsError):
    """Another start trains the model, or did a moment ago."""


def read_lease(model: ModelStore) -> Lease | None:
    return read_lease_at(model.bucket, keys.lease(model.prefix))


def read_lease_at(bucket: Bucket, key: str) -> Lease | None:
    """However old; None if missing or damaged, only `newer` of a newer drcli's."""
    try:
        data, age_s = bucket.get_with_age(key)
        lease = Lease.decode(data)
    except NewerFormat:
        return Lease.of_newer()
    except (ObjectMissing, RecordError):
        return None
    return replace(lease, age_s=time.time() - lease.renewed if age_s is None else age_s)


def write_lease(model: ModelStore, lease: Lease) -> None:
    model.bucket.put(keys.lease(model.prefix), lease.encode())


def holder(model: ModelStore) -> Lease | None:
    """None if missing or expired.

    A newer drcli's never expires: its owner would not recognise ours.
    """
    lease = read_lease(model)
    if lease is not None and lease.newer:
        return lease
    if lease is None or lease.released or lease.age_s >= STALE_S:
        return None
    return lease


def live_holder(model: ModelStore) -> Lease | None:
    held = holder(model)
    return held if held is not None and is_owner_alive(held) else None


def refuse_other_owner(model: ModelStore, session: str = "") -> None:
    """Return unless another session trains on the prefix.

    Raises:
        ModelInUse: One does.
        SettingsError: The owner is a newer drcli.
    """
    held = live_holder(model)
    if held is None or held.session == session:
        return
    if held.newer:
        raise _owned_by_newer(model)
    raise ModelInUse(
        f"{model.url} is being trained by {held.owner} "
        f"(last heard from {max(0.0, held.age_s):.0f} s ago).",
        remedy="Stop that training, or choose another DR_LOCAL_S3_MODEL_PREFIX. If that machine "
        f"is gone, try again in {STALE_S:.0f} seconds.",
    )


def _owned_by_newer(model: ModelStore) -> SettingsError:
    return SettingsError(
        f"{model.url} is or was trained by a newer version of drcli, whose lock "
        "this version cannot read.",
        remedy="Update drcli on this machine, or choose another DR_LOCAL_S3_MODEL_PREFIX.",
    )


def is_owner_alive(lease: Lease) -> bool:
    """On another machine, this is assumed."""
    return lease.newer or lease.machine != this_machine() or is_alive(lease.pid, lease.pid_started)


def take(model: ModelStore, session: str) -> Lease:
    """Own the prefix, then renew the lease.

    Raises:
        SettingsError: A newer drcli owns it.
    """
    before = read_lease(model)
    if before is not None and before.newer:
        raise _owned_by_newer(model)
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
    write_lease(model, lease)
    return lease


def release(model: ModelStore, session: str) -> None:
    lease = read_lease(model)
    if lease is not None and lease.session == session and not lease.released:
        write_lease(model, replace(lease, released=True, renewed=time.time()))


def lost_to(model: ModelStore, lease: Lease) -> OwnershipLost:
    is_or_was = "was" if lease.released else "is"
    return OwnershipLost(
        f"{model.url} {is_or_was} trained by {lease.owner}, "
        "which took over because this training had not renewed its lock for a minute. Everything "
        "this training did after that is discarded.",
        remedy="The model is safe; the other training continues. To continue here, stop the other "
        "training, then run `dr-start-training --resume` here.",
    )


class Ownership:
    """Checks for a process of a training that the prefix is still its own. Thread-safe.

    `trainer` is as in `Job`; `trusted_s` is for pointers; `clock` counts suspended time.
    """

    def __init__(
        self,
        model: ModelStore,
        session: str,
        term: int = 0,
        *,
        trainer: int | None = None,
        trusted_s: float = POINTER_TRUSTED_S,
        clock: Callable[[], float] = elapsed_s,
    ) -> None:
        self._model = model
        self._session = session
        self._trusted_s = trusted_s
        self._clock = clock
        self._term = term
        self._trainer = trainer
        self._read_s = -OTHERS_TRUSTED_S

    def check(self, key: str) -> None:
        """Return if this start still owns the prefix; called before `key` is written.

        Missing or damaged leases count as owned: the supervisor rewrites them.

        Raises:
            OwnershipLost: Another start or trainer process has it.
            StorageError: The lease cannot be read.
        """
        began_s = self._clock()
        if began_s - self._read_s < (self._trusted_s if keys.decides(key) else OTHERS_TRUSTED_S):
            return
        lease = read_lease(self._model)
        if lease is not None and lease.outranks(self._session, self._term):
            raise lost_to(self._model, lease)
        if lease is not None and lease.session == self._session:
            self._term = lease.term
            if self._trainer is not None and lease.trainer > self._trainer:
                raise OwnershipLost(
                    "Another process is the trainer now, because this one could not be reached.",
                    remedy="The training goes on there; nothing is to be done.",
                )
        self._read_s = began_s
