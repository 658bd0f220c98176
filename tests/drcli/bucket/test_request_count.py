"""Requests and bytes of a process, as the server sees them, and their sum over a run."""

import pytest

from drcli.bucket.request_count import CountFile, RequestCount, RequestCounter, read_counts
from drcli.bucket.s3_bucket import S3Bucket


@pytest.fixture
def counted(moto_endpoint):
    bucket = S3Bucket(moto_endpoint, "bucket", patience_s=5)
    bucket.ensure_exists()
    counter = RequestCounter()
    counter.attach(bucket._client)
    yield bucket, counter
    bucket.close()


def test_requests_are_counted_by_what_they_cost_with_their_bytes(counted):
    bucket, counter = counted

    bucket.put("a/1", b"x" * 1000)
    bucket.get("a/1")
    bucket.exists("a/1")
    bucket.exists("a/2")  # an answer that is an error is billed too
    bucket.list("a/")
    bucket.delete(["a/1"])

    count = counter.now()
    assert (count.puts, count.gets, count.deletes) == (2, 3, 1)
    assert count.sent_bytes >= 1000
    assert 1000 <= count.received_bytes < 3000
    assert count.list_price_usd == pytest.approx(2 * 0.005 / 1000 + 3 * 0.0004 / 1000)


def test_requests_without_an_answer_are_not_counted(counted):
    _, counter = counted
    before = counter.now().requests

    counter._answered(None, "response-received.s3.GetObject")

    assert counter.now().requests == before


def test_the_processes_of_a_start_add_up(tmp_path):
    for name, requests in (("trainer", 3), ("sim-0", 2)):
        counter = RequestCounter()
        for _ in range(requests):
            counter.add("GetObject")
        CountFile(tmp_path, name, "start", counter).write()

    assert read_counts(tmp_path, "start").gets == 5


def test_a_process_that_is_started_again_goes_on_counting(tmp_path):
    for _ in range(2):
        counter = RequestCounter()
        counter.add("ListObjectsV2")
        file = CountFile(tmp_path, "sim-0", "start", counter)
        file.write()
        file.write()

    assert read_counts(tmp_path, "start").puts == 2


def test_what_an_earlier_start_has_counted_does_not_count(tmp_path):
    counter = RequestCounter()
    counter.add("PutObject")
    CountFile(tmp_path, "trainer", "earlier", counter).write()
    (tmp_path / "sim-0.requests.json").write_text('{"puts": "many')

    assert read_counts(tmp_path, "start") == RequestCount("start")
    CountFile(tmp_path, "trainer", "start", counter).write()
    assert read_counts(tmp_path, "start").puts == 1
