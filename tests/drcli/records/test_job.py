"""What a launcher gives its worker processes, and what they leave behind for it."""

import math
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from drcli.config.loading import load_settings
from drcli.records import job as jobs
from drcli.records.job import THREAD_VARIABLES, Job, WorkerExit

EXIT = WorkerExit("The bucket is gone.", "Start it.", 4)

READS = """
from drcli.base.errors import SettingsError
from drcli.records.job import THREAD_VARIABLES, Job
try:
    print(repr(Job.received()))
except SettingsError as error:
    print(f"{error} {error.remedy}")
"""


@pytest.fixture
def job(working_folder) -> Job:
    """A start with several workers, some of whose settings are not plain texts."""
    (working_folder / "run.env").write_text(
        "DR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=2\nDR_TRACKS_DIR=mine\nTEAM_SECRET=hush\n"
    )
    (working_folder / "worker-2.env").write_text(
        "DR_RACE_TYPE=OBJECT_AVOIDANCE\nDR_OA_OBJECT_POSITIONS=0.25,-1;0.5,1\n"
    )
    config = load_settings(working_folder, environ={}).run
    return Job(
        config,
        "abc",
        7,
        1.5,
        working_folder / "data",
        os.getpid(),
        term=2,
        goals={"until_laps": 3.0},
    )


def read(job: Job) -> str:
    """What another process says of a job that it is given."""
    process = job.spawn([sys.executable, "-c", READS], stdout=subprocess.PIPE)
    return process.communicate(timeout=60)[0].decode().strip()


def test_a_job_is_the_same_in_the_process_that_gets_it(job):
    told = read(job)

    assert told == repr(job)
    assert "OBJECT_AVOIDANCE" in told
    assert "hush" not in told


def test_a_job_of_another_version_is_refused_with_a_reason(job, monkeypatch):
    monkeypatch.setattr(jobs, "VERSION", 2)

    told = read(job)

    assert "Invalid enum value 2 - at `$.version`" in told
    assert "start it again" in told


@pytest.mark.parametrize(
    "waits",
    [
        "from drcli.workers.worker_process import run; run('trainer', lambda *_: None)",
        "import runpy; runpy.run_module('drcli.run.training', run_name='__main__')",
        "import runpy; runpy.run_module('drcli.run.evaluation', run_name='__main__')",
    ],
    ids=["worker", "supervisor", "evaluation"],
)
def test_a_process_without_a_job_that_fits_says_so_in_one_line(job, monkeypatch, waits):
    monkeypatch.setattr(jobs, "VERSION", 2)
    process = job.spawn(
        [sys.executable, "-c", waits, "20260101000000", "c"], stderr=subprocess.PIPE
    )

    told = process.communicate(timeout=60)[1].decode()

    assert process.returncode == 3
    assert told == (
        "This process cannot read its job: Invalid enum value 2 - at `$.version`. Stop the run and "
        "start it again; drcli may have been updated in the meantime.\n"
    )


@pytest.mark.parametrize("minutes", [math.inf, math.nan])
def test_a_job_that_no_process_could_read_fails_where_it_is_launched(job, tmp_path, minutes):
    touched = tmp_path / "touched"

    with pytest.raises(ValueError, match="not JSON compliant"):
        replace(job, max_minutes=minutes).spawn(["touch", str(touched)])

    assert not touched.exists()


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("world_name", 7, "'world_name' is not a text"),
        ("race_type", "FOOTBALL", "'race_type' is not one of TIME_TRIAL"),
        ("sim_blur", "100", "'sim_blur' is above 4"),
    ],
)
def test_a_race_that_does_not_fit_is_refused_with_a_reason(job, monkeypatch, field, value, reason):
    def spoiled(part: object) -> object:
        return {**part.to_json(), field: value} if hasattr(part, "to_json") else str(part)

    monkeypatch.setattr(jobs, "json_default", spoiled)

    assert reason in read(job)


def test_why_a_worker_ended_is_read_until_it_is_deleted(tmp_path):
    EXIT.write(tmp_path / "run", "sim-0")

    assert WorkerExit.read(tmp_path / "run", "sim-0") == EXIT
    assert WorkerExit.read(tmp_path / "run", "trainer") is None
    WorkerExit.delete(tmp_path / "run", "sim-0")
    assert WorkerExit.read(tmp_path / "run", "sim-0") is None


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"message": "half"}'])
def test_a_damaged_exit_file_counts_as_missing(tmp_path, content):
    EXIT.write(tmp_path, "sim-0")
    [path] = tmp_path.iterdir()

    path.write_text(content)

    assert WorkerExit.read(tmp_path, "sim-0") is None


def test_a_full_disk_keeps_the_failure_itself_from_being_replaced(tmp_path, monkeypatch):
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)

    EXIT.write(tmp_path, "sim-0")

    assert list(tmp_path.iterdir()) == []


LIBRARIES = "import os; print(*(os.environ.get(name) for name in {names!r}))"


@pytest.mark.parametrize(("threads", "limit"), [(0, "None"), (3, "3")])
def test_a_limit_of_threads_reaches_the_libraries_that_compute(job, monkeypatch, threads, limit):
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    limited = replace(
        job, config=replace(job.config, train=job.config.train.replaced(threads=threads))
    )

    process = limited.spawn(
        [sys.executable, "-c", LIBRARIES.format(names=THREAD_VARIABLES)], stdout=subprocess.PIPE
    )

    assert process.communicate(timeout=60)[0].decode().split() == [limit] * len(THREAD_VARIABLES)
