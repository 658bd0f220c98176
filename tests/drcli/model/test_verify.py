"""Whether an object is the one that was sent, whatever its server says about it."""

import hashlib
from dataclasses import replace

import pytest

from drcli.bucket import s3_bucket
from drcli.model import verify
from drcli.model.verify import Checksums

DATA = b"0123456789"


def info(bucket):
    (found,) = bucket.list("")
    return found


@pytest.fixture
def unread(wire, monkeypatch):
    """A bucket over the wire whose objects cannot be read, only listed."""

    def refuse(key, **_):
        raise AssertionError(f"{key} was read")

    monkeypatch.setattr(wire, "get", refuse)
    return wire


def test_the_etag_of_an_object_in_one_piece_is_proof_enough(unread):
    unread.put("k", DATA)

    assert Checksums.of(DATA).matches(unread, info(unread))


def test_the_etag_of_an_object_in_parts_is_proof_enough(unread, monkeypatch):
    for name, size in (("MULTIPART_FROM_BYTES", 6 << 20), ("PART_BYTES", 5 << 20)):
        monkeypatch.setattr(s3_bucket, name, size)
    monkeypatch.setattr(verify, "PART_BYTES", 5 << 20)
    data = bytes(range(256)) * (7 << 12)
    unread.put("k", data)

    assert info(unread).etag.endswith("-2")
    assert Checksums.of(data).matches(unread, info(unread))


def test_an_object_of_another_size_is_another_one(unread):
    unread.put("k", DATA + b"!")

    assert not Checksums.of(DATA).matches(unread, info(unread))


@pytest.mark.parametrize("etag", ["", hashlib.md5(b"encrypted").hexdigest()])
@pytest.mark.parametrize(("there", "same"), [(DATA, True), (b"9876543210", False)])
def test_an_object_without_a_telling_etag_is_read(bucket, etag, there, same):
    bucket.put("k", there)

    assert Checksums.of(DATA).matches(bucket, replace(info(bucket), etag=etag)) is same


def test_an_object_that_is_not_listed_or_gone_is_not_there(bucket):
    bucket.put("k", DATA)
    found = replace(info(bucket), etag="")
    bucket.delete(["k"])

    assert not Checksums.of(DATA).matches(bucket, None)
    assert not Checksums.of(DATA).matches(bucket, found)
