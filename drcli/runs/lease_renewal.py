"""Renews the lease of a training, and notices when another one has taken it."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

from drcli.base.elapsed import elapsed_s
from drcli.base.errors import OwnershipLost
from drcli.exchange.run_state import Lease
from drcli.store.bucket import Bucket
from drcli.store.lease import STALE_S, lost_to, read_lease, write_lease

LOOK_S = 4.0
"""Who loses a lease must end within 15 seconds, which its workers need."""

RENEW_S = 10.0
_HELD_UP_S = 5.0


class Renewal:
    """Renews a lease step by step until it is lost.

    The clock must also count while this process is stopped.
    """

    def __init__(
        self, bucket: Bucket, prefix: str, lease: Lease, *, clock: Callable[[], float] = elapsed_s
    ) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._lease = lease
        self._clock = clock
        self._written_s = self._owned_s = clock()
        self.lost: OwnershipLost | None = None
        """Why the training must end; None while it holds the lease."""

    def begin_trainer(self, number: int) -> None:
        """Let no trainer with a lower number write any more.

        Raises:
            StorageError: The next step tries again.
        """
        self._lease = replace(self._lease, trainer=number)
        self._written_s = -math.inf
        self.step()

    def step(self) -> None:
        """Check who holds the lease, and write it if due.

        Raises:
            StorageError: The next step tries again.
        """
        now_s = self._clock()
        found = read_lease(self._bucket, self._prefix)
        if found is not None and found.outranks(self._lease.session, self._lease.term):
            self.lost = lost_to(self._bucket, self._prefix, found)
            return
        ours = found is not None and found.session == self._lease.session
        if found is None and now_s - self._owned_s > STALE_S:
            self.lost = OwnershipLost(
                f"s3://{self._bucket.name}/{self._prefix} could not be reached for "
                f"{now_s - self._owned_s:.0f} s, and the lease of this training is gone.",
                remedy="Check with `dr-list-models` that the model still exists, then continue "
                "with `dr-start-training --resume`.",
            )
            return
        self._owned_s = now_s
        if ours and now_s - self._written_s < RENEW_S:
            return
        if self._clock() - now_s > _HELD_UP_S:
            return  # another training may have taken it since it was read
        write_lease(self._bucket, self._prefix, replace(self._lease, renewed=time.time()))
        self._written_s = now_s
