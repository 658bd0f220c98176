"""The proxy: what a network without faults lets through, and what each fault does to a client."""

import time

import pytest

from drcli.base.errors import DiskFull, NoAnswer, StorageError
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from fault_machine import BUCKET, Storage
from fault_proxy import Proxy

pytestmark = pytest.mark.nightly

DATA = bytes(range(256)) * 2_000


@pytest.fixture(scope="module")
def storage(tmp_path_factory):
    served = Storage(tmp_path_factory.mktemp("faults") / "bucket", disk=False)
    yield served
    served.close()


@pytest.fixture
def proxy(storage):
    opened = Proxy(storage.state.port, seed=3)
    yield opened
    opened.close()


@pytest.fixture
def bucket(storage, proxy):
    """The bucket through the proxy, emptied."""
    state = storage.state
    opened = S3Bucket(
        Endpoint(proxy.url, state.access_key, state.secret_key),
        BUCKET,
        patience_s=2.0,
        read_timeout_s=1.0,
    )
    opened.delete(info.key for info in opened.list(""))
    yield opened
    opened.close()


def test_without_faults_everything_passes(bucket, proxy):
    bucket.put("a/b c", DATA)
    bucket.put("a/empty", b"")

    assert bucket.get("a/b c") == DATA
    assert [(info.key, info.size_bytes) for info in bucket.list("a/")] == [
        ("a/b c", len(DATA)),
        ("a/empty", 0),
    ]
    assert bucket.exists("a/empty")
    bucket.delete(["a/empty"])
    assert not bucket.exists("a/empty")
    written = [write.path for write in proxy.writes if write.method == "PUT"]
    assert written == [f"{BUCKET}/a/b c", f"{BUCKET}/a/empty"]
    assert proxy.counts.failed == 0


@pytest.mark.parametrize("code", ["internal", "busy", "slow_down"])
def test_some_errors_are_overcome(bucket, proxy, code):
    proxy.set(error=code, error_share=0.4)

    for number in range(10):
        bucket.put(f"k{number}", DATA)
        assert bucket.get(f"k{number}") == DATA

    assert proxy.counts.failed > 0


def test_a_full_server_refuses_writes_only(bucket, proxy):
    bucket.put("k", DATA)
    proxy.set(error="full", error_share=1.0)

    assert bucket.get("k") == DATA
    with pytest.raises(DiskFull):
        bucket.put("k", DATA)


@pytest.mark.parametrize("part", ["request", "answer"])
def test_bodies_that_break_off_leave_whole_objects_alone(bucket, proxy, storage, part):
    bucket.put("k", DATA)
    proxy.set(cut=part, cut_share=0.4)

    for number in range(5):
        data = DATA[number:]
        bucket.put("k", data)
        assert bucket.get("k") == data

    assert proxy.counts.failed > 0
    proxy.set(cut="request", cut_share=1.0)
    with pytest.raises(NoAnswer):
        bucket.put("k", b"x" * 1_000)
    assert storage.path("k").read_bytes() == data


def test_a_refused_connection_is_waited_for(bucket, proxy):
    bucket.put("k", DATA)
    proxy.set(refused=True)
    with pytest.raises(NoAnswer):
        bucket.get("k")

    proxy.set(refused=False)

    assert bucket.get("k") == DATA


def test_a_listing_is_as_old_as_it_is_said_to_be(bucket, proxy):
    bucket.put("a/1", DATA)
    assert [info.key for info in bucket.list("a/")] == ["a/1"]
    proxy.set(old_lists=True)
    bucket.put("a/2", DATA)

    assert [info.key for info in bucket.list("a/")] == ["a/1"]
    proxy.set(old_lists=False)
    assert [info.key for info in bucket.list("a/")] == ["a/1", "a/2"]


def test_latency_and_bandwidth_take_their_time(bucket, proxy):
    proxy.set(latency_s=0.3, bytes_per_s=1_000_000)
    began_s = time.monotonic()

    bucket.put("k", DATA)

    assert time.monotonic() - began_s >= 0.3 + len(DATA) / 1_000_000


def test_the_servers_clock_can_be_ahead(bucket, proxy):
    bucket.put("k", DATA)
    proxy.set(server_ahead_s=90.0)

    _, age_s = bucket.get_with_age("k")

    assert age_s is not None
    assert 89.0 <= age_s <= 120.0


def test_a_silent_server_is_given_up(bucket, proxy):
    proxy.set(silent=True)
    began_s = time.monotonic()

    with pytest.raises(StorageError):
        bucket.get("k")

    assert time.monotonic() - began_s >= 1.0
    proxy.set(silent=False)
