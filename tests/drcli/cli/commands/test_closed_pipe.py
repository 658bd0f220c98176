"""Whoever closes the pipe early, as `dr-status | head -0`, still learns how the command ended."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drcli.config.loading import load_settings
from drcli.records.run_record import RunRecord, run_folder


def ended(folder: Path, *arguments: str, closed: str) -> tuple[int, str]:
    """Exit code of a command one of whose streams nobody reads, and what the other one got."""
    reader, writer = os.pipe()
    os.close(reader)
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, closed: writer}
    done = subprocess.run(
        [str(Path(sys.executable).parent / "dr"), *arguments],
        cwd=folder,
        text=True,
        timeout=60,
        **streams,
    )
    os.close(writer)
    return done.returncode, done.stderr or done.stdout or ""


@pytest.fixture
def lost(working_folder: Path) -> Path:
    """A folder whose training has vanished."""
    settings = load_settings(working_folder)
    RunRecord(
        run_id=0,
        session="abc",
        bucket="bucket",
        prefix="model",
        world="reinvent_base",
        state="running",
        pid=2**22,
        pid_started=1.0,
        started_at=time.time(),
    ).write(run_folder(working_folder, settings.run_id))
    return working_folder


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_closed_standard_output_does_not_hide_a_failure(lost, options):
    code, said = ended(lost, "status", *options, closed="stdout")

    assert code == 5
    assert "The supervisor died" in said
    assert "BrokenPipe" not in said


def test_a_closed_standard_error_does_not_hide_a_failure_either(lost):
    code, said = ended(lost, "status", closed="stderr")

    assert code == 5
    assert "Run 0: lost" in said
