"""One training with faults for all tests that look at what comes of it."""

from pathlib import Path

import pytest

from drcli.bucket.connect import FolderBucket
from fault_machine import BUCKET
from fault_run import FaultRun, Verdict
from fault_schedule import SHORT, parse


@pytest.fixture(scope="session")
def with_faults(tmp_path_factory: pytest.TempPathFactory) -> tuple[Verdict, Path]:
    """The verdict about a training with faults, and the folder of its bucket at the end."""
    folder = tmp_path_factory.mktemp("faults")
    run = FaultRun(folder / "run", parse(SHORT), workers=1, disk=False, keep=folder / BUCKET)
    return run.run(), folder / BUCKET


@pytest.fixture
def model(with_faults: tuple[Verdict, Path]) -> FolderBucket:
    """The bucket of that training."""
    return FolderBucket(with_faults[1])
