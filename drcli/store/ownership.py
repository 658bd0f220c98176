"""Who trains on a model prefix, as everybody who writes there must know: the lease.

The lease is a note in the bucket that its owner writes again and again. It is no lock: nothing
waits for it, and one that was not renewed for a minute means nothing. So another machine may take
the prefix over while its owner is only held up (stopped, asleep, without network). Whoever writes
therefore reads the note first, and ends when it is somebody else's. Nothing rests on conditional
writes, which not all S3 servers know, nor on the clocks of two machines agreeing: only the server's
clock tells how old the note is.
"""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

from drcli.base.errors import OwnershipLost
from drcli.base.json_record import Misfit, built, parsed
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

POINTER_TRUSTED_S = 0.1
"""How long what was read of the lease is believed before a pointer is written: two in a row need
one look."""

OTHERS_TRUSTED_S = 1.0
"""The same before other objects (`keys.decides`). A new owner's processes take longer to start."""


@dataclass(frozen=True)
class Lease:
    """The note.

    Attributes:
        session: Unique name of the start that owns the prefix.
        host: Name of its machine, for people.
        pid: Its supervisor there.
        renewed: Unix seconds by the clock of that machine.
        machine: What no other machine or container has, empty where it is not known.
        pid_started: When that process began there.
        term: Counts the owners of the prefix. Of two notes the one with the higher term is right:
            an owner that was held up may write its note once more after it lost the prefix.
        released: Whether the owner has ended. The note stays, so that one who owned the prefix
            before, and was held up all the while, still learns that there was another.
        age_s: How long ago it was written; not part of the note.
    """

    session: str
    host: str
    pid: int
    renewed: float
    machine: str = ""
    pid_started: float = 0.0
    term: int = 0
    released: bool = False
    age_s: float = 0.0

    def to_bytes(self) -> bytes:
        """The note as JSON."""
        fields = asdict(self)
        del fields["age_s"]
        return json.dumps(fields, allow_nan=False).encode()

    def outranks(self, session: str, term: int) -> bool:
        """Whether a start that owned the prefix in some term has lost it to this one."""
        return self.session != session and self.term >= term


def read_lease(bucket: Bucket, prefix: str) -> Lease | None:
    """The note, however old; None where there is none that can be read."""
    try:
        data, age_s = bucket.get_with_age(keys.lease(prefix))
        lease = built(Lease, parsed(data))
    except (ObjectMissing, Misfit):
        return None
    return replace(lease, age_s=time.time() - lease.renewed if age_s is None else age_s)


def write_lease(bucket: Bucket, prefix: str, lease: Lease) -> None:
    """Write the note."""
    bucket.put(keys.lease(prefix), lease.to_bytes())


def elapsed_s() -> float:
    """A clock for how long this process was held up: it also counts a suspended machine."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


def lost_to(bucket: Bucket, prefix: str, lease: Lease) -> OwnershipLost:
    """What a start says that has lost the prefix to another."""
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
        bucket: Where the lease lies.
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

        A note that is missing or unreadable is no other owner's: the supervisor writes it again.

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
