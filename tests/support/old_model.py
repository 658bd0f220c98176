"""The model that version 0.1.0 trained. `scripts/make_old_model.sh` has made the archive."""

import tarfile
from pathlib import Path

import zstandard

_ARCHIVE = Path(__file__).resolve().parents[1] / "data" / "trained-with-0.1.0.tar.zst"


def extract_old_model(bucket: Path) -> None:
    """Make the folder of a bucket with the model, and with its files in custom_files/."""
    bucket.mkdir(parents=True)
    with (
        _ARCHIVE.open("rb") as packed,
        zstandard.ZstdDecompressor().stream_reader(packed) as plain,
        tarfile.open(fileobj=plain, mode="r|") as archive,
    ):
        if hasattr(tarfile, "data_filter"):  # Python 3.11.4 and later, which warn without a filter
            archive.extraction_filter = tarfile.data_filter
        archive.extractall(bucket)
