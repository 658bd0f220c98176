"""Records of joined simulation workers, as the trainer reads them."""

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime

from drcli.base.json_record import RecordError
from drcli.exchange.joined_worker import MemberRecord, Shares, SharesRecord
from drcli.store import keys
from drcli.store.bucket import (
    READS_FAR,
    Bucket,
    ObjectDamaged,
    ObjectInfo,
    ObjectMissing,
    read_record,
)
from drcli.store.remedies import remedy_of

RENEWED_S = 5.0
GONE_S = 20.0
"""A worker that did not renew its record for so long is gone."""

MISSED_S = 2.0 * RENEWED_S
"""After two missed renewals, a worker is not waited for."""

FORGOTTEN_S = 600.0
"""Then the record is deleted and the worker loses its number."""


def read_shares_record(bucket: Bucket, prefix: str) -> SharesRecord | None:
    """None before a worker joined, or if damaged."""
    key = keys.shares(prefix)
    try:
        return read_record(bucket, key, SharesRecord.decode, remedy_of(key))
    except (ObjectMissing, ObjectDamaged):
        return None


def read_shares(bucket: Bucket, prefix: str, session: str, iteration: int) -> Shares | None:
    record = read_shares_record(bucket, prefix)
    return record.at(iteration) if record is not None and record.session == session else None


@dataclass(frozen=True)
class Member:
    record: MemberRecord
    silent_s: float

    @property
    def is_alive(self) -> bool:
        return self.silent_s < GONE_S


@dataclass(frozen=True)
class _Seen:
    modified: datetime
    record: MemberRecord
    seen_s: float


class MemberReader:
    """Reads records of one session; only changed ones cost a request."""

    def __init__(
        self,
        bucket: Bucket,
        prefix: str,
        session: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._session = session
        self._clock = clock
        self._seen: dict[str, _Seen] = {}

    def _records(self, changed: Mapping[str, ObjectInfo]) -> dict[str, MemberRecord | None]:
        def read(info: ObjectInfo) -> MemberRecord | None:
            try:
                return MemberRecord.decode(self._bucket.get(info.key))
            except (ObjectMissing, RecordError):
                return None

        if len(changed) < 2:
            return {name: read(info) for name, info in changed.items()}
        with ThreadPoolExecutor(min(READS_FAR, len(changed))) as readers:
            return dict(zip(changed, readers.map(read, changed.values()), strict=True))

    def read(self) -> dict[str, Member]:
        found: dict[str, _Seen] = {}
        changed: dict[str, ObjectInfo] = {}
        for info in self._bucket.list(keys.members_folder(self._prefix)):
            name = keys.member_of(self._prefix, info.key)
            if name is None:
                continue
            before = self._seen.get(name)
            if before is not None and before.modified == info.modified:
                found[name] = before
            else:
                changed[name] = info
        for name, record in self._records(changed).items():
            before = self._seen.get(name)
            if record is None:
                if before is not None:  # it is just written, or damaged
                    found[name] = before
                continue
            unchanged = before is not None and before.record == record
            seen_s = before.seen_s if before is not None and unchanged else self._clock()
            found[name] = _Seen(changed[name].modified, record, seen_s)
        self._seen = found
        now_s = self._clock()
        members = {name: Member(each.record, now_s - each.seen_s) for name, each in found.items()}
        old = [name for name, member in members.items() if member.silent_s >= FORGOTTEN_S]
        self._bucket.delete([keys.member(self._prefix, name) for name in old])
        return {
            name: member
            for name, member in members.items()
            if member.record.session == self._session and name not in old
        }
