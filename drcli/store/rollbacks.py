"""Reads and writes the rollbacks of a model."""

from drcli.exchange.rollback_record import Rollbacks
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing, read_record
from drcli.store.remedies import remedy_of


def read_rollbacks(bucket: Bucket, prefix: str) -> Rollbacks:
    key = keys.rollbacks(prefix)
    try:
        return read_record(bucket, key, Rollbacks.decode, remedy_of(key))
    except ObjectMissing:
        return Rollbacks()


def write_rollbacks(bucket: Bucket, prefix: str, rollbacks: Rollbacks) -> None:
    """With this write, the newest one has happened."""
    bucket.put(keys.rollbacks(prefix), rollbacks.encode())
