"""Addresses of bucket, model and files: as s3:// names, on the web, and on this disk."""

from dataclasses import dataclass
from typing import Literal
from urllib.parse import quote

from drcli.config.settings import ModelConfig, StorageConfig
from drcli.store import keys
from drcli.store.endpoint import Endpoint
from drcli.store.server import server

PlaceName = Literal["bucket", "model", "custom-files", "metrics"]


@dataclass(frozen=True)
class Place:
    """A folder in the bucket.

    Attributes:
        name: What it is.
        s3: Its name, as the aws command takes it.
        http: Its address, None where the local server was never started. Reading it takes the keys.
        folder: Where it lies on this disk, None where only a server knows.
    """

    name: PlaceName
    s3: str
    http: str | None
    folder: str | None


@dataclass(frozen=True)
class Addresses:
    """The bucket's server, and what lies there.

    Attributes:
        cloud: DR_CLOUD.
        endpoint: Address of the server, None where the local one was never started.
        running: Whether the local server's process runs; None for other servers.
        region: Region to sign for.
        places: What was asked for.
    """

    cloud: str
    endpoint: str | None
    running: bool | None
    region: str
    places: list[Place]


def addresses(
    storage: StorageConfig, model: ModelConfig, custom_files: str, names: list[PlaceName]
) -> Addresses:
    """Look up addresses; starts and asks no server."""
    endpoint = server.last_known(storage)
    prefixes: dict[PlaceName, str] = {
        "bucket": "",
        "model": keys.folder(model.prefix),
        "custom-files": keys.folder(custom_files),
        "metrics": keys.folder(model.metrics_prefix),
    }
    return Addresses(
        cloud=storage.cloud,
        endpoint=None if endpoint is None else _server(endpoint),
        running=None
        if storage.cloud != "local"
        else endpoint is not None and endpoint.pid is not None,
        region=storage.region,
        places=[
            Place(
                name,
                f"s3://{storage.bucket}/{prefixes[name]}",
                None if endpoint is None else _http(endpoint, storage.bucket, prefixes[name]),
                _folder(storage, prefixes[name]),
            )
            for name in names
        ],
    )


def _server(endpoint: Endpoint) -> str:
    return endpoint.place if endpoint.url else f"https://s3.{endpoint.region}.amazonaws.com"


def _http(endpoint: Endpoint, bucket: str, prefix: str) -> str:
    """Amazon names the bucket in the host, other servers in the path."""
    if endpoint.url is None:
        return f"https://{bucket}.s3.{endpoint.region}.amazonaws.com/{quote(prefix)}"
    return f"{endpoint.place.rstrip('/')}/{bucket}/{quote(prefix)}"


def _folder(storage: StorageConfig, prefix: str) -> str | None:
    """Where objects lie as plain files, as rclone keeps them; others have formats of their own."""
    if storage.cloud != "local" or storage.engine != "rclone":
        return None
    return str(storage.data_dir / storage.bucket / prefix)
