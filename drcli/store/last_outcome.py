"""What the newest start of a run came to."""

from drcli.base import notices
from drcli.exchange.run_outcome import RunOutcome
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record
from drcli.store.remedies import remedy_of


def read_outcome(bucket: Bucket, prefix: str) -> RunOutcome | None:
    """None if missing or damaged, as after the loss of a machine.

    Raises:
        ObjectNewer: A newer drcli wrote it.
    """
    key = keys.outcome(prefix)
    try:
        return read_record(bucket, key, RunOutcome.decode, remedy_of(key))
    except ObjectMissing:
        return None
    except ObjectDamaged as error:
        notices.warn(f"{error} {error.remedy}")
        return None


def write_outcome(bucket: Bucket, prefix: str, outcome: RunOutcome) -> None:
    bucket.put(keys.outcome(prefix), outcome.encode())
