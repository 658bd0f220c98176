"""Rule V-50: a bucket that works, and one that does not."""

import pytest

from drcli.base.errors import StorageError
from drcli.checks.start_rules import probe
from drcli.model.model_store import ModelStore
from memory_bucket import MemoryBucket


class ForgetfulBucket(MemoryBucket):
    """Takes everything and keeps nothing of it."""

    def get(self, key: str) -> bytes:
        return b""


def test_a_bucket_that_works_is_left_empty():
    bucket = MemoryBucket()

    assert probe(ModelStore(bucket, "model")) == []
    assert bucket.list("") == []


def test_a_bucket_that_gives_back_something_else_is_an_error_and_left_empty():
    bucket = ForgetfulBucket()

    with pytest.raises(StorageError, match="does not correctly return"):
        probe(ModelStore(bucket, "model"))

    assert bucket.list("") == []
