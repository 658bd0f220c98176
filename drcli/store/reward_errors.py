"""Reads the counted failures of a reward function."""

from drcli.base.json_record import RecordError
from drcli.exchange.reward_error_record import RewardErrorRecord
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing


def read_reward_errors(bucket: Bucket, prefix: str) -> list[RewardErrorRecord]:
    """By worker, without damaged ones.

    Raises:
        StorageError: The bucket does not answer.
    """
    found = []
    for info in bucket.list(keys.reward_errors_folder(prefix)):
        try:
            found.append(RewardErrorRecord.decode(bucket.get(info.key)))
        except (ObjectMissing, RecordError):  # its worker writes it again
            continue
    return sorted(found, key=lambda record: record.worker)
