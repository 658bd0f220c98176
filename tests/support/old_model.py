"""Models of earlier versions. `scripts/make_old_model.sh` has made the archives."""

import tarfile
from pathlib import Path

import zstandard

_DATA = Path(__file__).resolve().parents[1] / "data"


def extract_old_model(bucket: Path, archive_name: str = "trained-with-0.1.0") -> None:
    """Make the folder of a bucket with its models, and with their files in custom_files/."""
    bucket.mkdir(parents=True)
    with (
        (_DATA / f"{archive_name}.tar.zst").open("rb") as packed,
        zstandard.ZstdDecompressor().stream_reader(packed) as plain,
        tarfile.open(fileobj=plain, mode="r|") as archive,
    ):
        if hasattr(tarfile, "data_filter"):  # Python 3.11.4 and later, which warn without a filter
            archive.extraction_filter = tarfile.data_filter
        archive.extractall(bucket)
