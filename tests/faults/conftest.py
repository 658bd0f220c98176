"""One training with faults for all tests that look at what comes of it."""

from pathlib import Path

import pytest

from drcli.store.folder_bucket import FolderBucket
from fault_machine import BUCKET
from fault_run import FaultRun, Verdict
from fault_schedule import parse

SCHEDULE = """
1 kill process=trainer
2 damage object=metrics how=half seed=1
2 errors code=internal share=0.3 for_s=3
3 clock ahead_s=-600
3 cut part=answer share=0.3 for_s=2
4 damage object=history how=bit seed=3
4 kill process=supervisor
5 stop process=server for_s=2
6 kill process=sim-0
7 gone cloud=local
8 kill process=server
8 damage object=pointer how=empty seed=5
"""
"""What takes a minute on two cores. `scripts/faults` has the longer forms."""

WORKERS = 1


@pytest.fixture(scope="session")
def with_faults(tmp_path_factory: pytest.TempPathFactory) -> tuple[Verdict, Path]:
    """The verdict about a training with faults, and the folder of its bucket at the end."""
    folder = tmp_path_factory.mktemp("faults")
    run = FaultRun(
        folder / "run", parse(SCHEDULE), workers=WORKERS, disk=False, keep=folder / BUCKET
    )
    return run.run(), folder / BUCKET


@pytest.fixture
def model(with_faults: tuple[Verdict, Path]) -> FolderBucket:
    """The bucket of that training."""
    return FolderBucket(with_faults[1])
