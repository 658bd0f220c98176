"""Addresses of bucket, model and files: s3://, http and on this disk."""

from dataclasses import dataclass
from typing import Literal
from urllib.parse import quote

from drcli.config.bucket_config import ModelConfig, StorageConfig
from drcli.store import keys
from drcli.store.endpoint import Endpoint
from drcli.store.server import server

PlaceName = Literal["bucket", "model", "custom-files", "metrics"]


@dataclass(frozen=True)
class AddressedPlace:
    """A folder in the bucket.

    Attributes:
        name: bucket, model, custom-files or metrics.
        s3: Its s3:// address, for the aws command.
        http: Its http address, None before the first start of the local server. Needs the keys.
        folder: Its folder on this disk, None if it is only on a server.
    """

    name: PlaceName
    s3: str
    http: str | None
    folder: str | None


@dataclass(frozen=True)
class Addresses:
    """The bucket's server and folders.

    Attributes:
        cloud: DR_CLOUD.
        endpoint: Address of the server, None before the first start of the local one.
        running: Whether the local server's process runs; None for other servers.
        region: Region of the bucket.
        places: The folders.
    """

    cloud: str
    endpoint: str | None
    running: bool | None
    region: str
    places: list[AddressedPlace]


def addresses(
    storage: StorageConfig, model: ModelConfig, custom_files: str, names: list[PlaceName]
) -> Addresses:
    endpoint = server.last_known(storage)
    lives = endpoint is not None and endpoint.pid is not None
    prefixes: dict[PlaceName, str] = {
        "bucket": "",
        "model": keys.folder(model.prefix),
        "custom-files": keys.folder(custom_files),
        "metrics": keys.folder(model.metrics_prefix),
    }
    return Addresses(
        cloud=storage.cloud,
        endpoint=None if endpoint is None else _server(endpoint),
        running=lives if storage.cloud == "local" else None,
        region=storage.region,
        places=[
            AddressedPlace(
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
    if endpoint.url is None:
        return f"https://{bucket}.s3.{endpoint.region}.amazonaws.com/{quote(prefix)}"
    return f"{endpoint.place.rstrip('/')}/{bucket}/{quote(prefix)}"


def _folder(storage: StorageConfig, prefix: str) -> str | None:
    """Only rclone keeps objects as plain files."""
    if storage.cloud != "local" or storage.engine != "rclone":
        return None
    return str(storage.data_dir / storage.bucket / prefix)
