"""Who may train on a model prefix."""

import json
import os
import socket
import time

import pytest

from drcli.errors import SettingsError
from drcli.runs import lease
from drcli.store import keys
from drcli.store.memory import MemoryBucket


@pytest.fixture
def bucket():
    return MemoryBucket()


def test_the_prefix_of_somebody_else_is_refused_and_named(bucket):
    lease.renew(bucket, "model", "theirs")

    with pytest.raises(SettingsError, match=f"trained by process {os.getpid()}"):
        lease.refuse_other_owner(bucket, "model", "ours")


def test_the_own_prefix_is_not_refused(bucket):
    lease.renew(bucket, "model", "ours")

    lease.refuse_other_owner(bucket, "model", "ours")


def test_a_note_that_was_not_renewed_means_nothing(bucket):
    note = {"session": "theirs", "host": "elsewhere", "pid": 1, "renewed": time.time() - 61.0}
    bucket.put(keys.lease("model"), json.dumps(note).encode())

    assert lease.holder(bucket, "model") is None


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff", b"[]", b"null", b'{"session": "a"}', b"{}"],
)
def test_a_note_that_nobody_can_read_is_stale(bucket, content):
    bucket.put(keys.lease("model"), content)

    lease.refuse_other_owner(bucket, "model")

    assert lease.holder(bucket, "model") is None


def test_a_note_whose_time_is_no_number_is_stale(bucket):
    note = {"session": "a", "host": socket.gethostname(), "pid": 1, "renewed": "now"}
    bucket.put(keys.lease("model"), json.dumps(note).encode())

    assert lease.holder(bucket, "model") is None
