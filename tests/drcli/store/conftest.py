"""Buckets to test with: in memory, over the wire to moto, and on a real rclone server."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from amazon_server import amazon_server
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.config.run_config import StorageConfig
from memory_bucket import MemoryBucket


@pytest.fixture
def memory() -> MemoryBucket:
    return MemoryBucket()


@pytest.fixture(scope="session")
def moto_endpoint() -> Iterator[Endpoint]:
    with amazon_server() as address:
        yield Endpoint(address, access_key="testing", secret_key="testing")


@pytest.fixture
def wire(moto_endpoint: Endpoint) -> Iterator[S3Bucket]:
    bucket = S3Bucket(moto_endpoint, "bucket", patience_s=5)
    bucket.ensure_exists()
    yield bucket
    bucket.delete([info.key for info in bucket.list("")])
    bucket.close()


@pytest.fixture(params=["memory", "wire"])
def bucket(request: pytest.FixtureRequest) -> MemoryBucket | S3Bucket:
    """The same contract for both kinds."""
    kind: MemoryBucket | S3Bucket = request.getfixturevalue(request.param)
    return kind


@pytest.fixture
def local(tmp_path: Path) -> Iterator[StorageConfig]:
    """Settings of a real local server, ended after the test whatever it was started by."""
    config = StorageConfig("local", "bucket", tmp_path / "s3")
    yield config
    server.stop(config)
