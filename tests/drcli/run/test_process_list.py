"""How fast a simulation worker drives, from the newest trace of its training."""

import os

import pytest

from drcli.model import keys
from drcli.records.run_record import WorkerRecord, run_folder
from drcli.records.trace import csv_text
from drcli.run.worker_processes import Process, SpeedReport, speed_of
from own_run import own_run
from simtraces import episode

SIM_1 = Process("sim-1", os.getpid(), True, "sim-1.log")
UNKNOWN = SpeedReport("sim-1", os.getpid())
# 30 rows of two episodes in 6 s: 5 rows/s of 15 in real time.
TRACE = csv_text([episode(0, 20), episode(1, 10)], (1000.0, 1006.0))


@pytest.fixture
def speed(racer, monkeypatch, make_record):
    """Measures the second of two workers, whose newest trace is this text."""
    settings = racer.settings().run
    own_run(
        workers=[WorkerRecord(name, os.getpid(), 0) for name in ("trainer", "sim-0", "sim-1")]
    ).write(run_folder(racer.folder, settings.run_id))
    monkeypatch.setattr("drcli.run.worker_processes.open_running_bucket", lambda _: racer.bucket)
    monkeypatch.setattr("drcli.run.worker_processes.read_history", lambda *_: [make_record(3)])

    def measure(trace: str | None) -> SpeedReport:
        if trace is not None:
            key = keys.training_trace("model-1", 3, worker=1, workers=2)
            racer.bucket.put(key, trace.encode())
        return speed_of(SIM_1, settings)

    return measure


@pytest.mark.parametrize("columns", [20, 19])
def test_speed_is_rows_by_their_wall_clock_with_and_without_our_column(speed, columns):
    trace = "".join(f"{','.join(line.split(',')[:columns])}\n" for line in TRACE.splitlines())

    found = speed(trace)

    assert (found.worker, found.iteration, found.steps) == ("sim-1", 3, 30)
    assert found.steps_per_s == pytest.approx(5.0)
    assert found.real_time_factor == pytest.approx(5.0 / 15.0)


def test_a_damaged_row_does_not_hide_the_speed(speed):
    lines = TRACE.splitlines()
    lines[5] = lines[5].rpartition(",")[0].rpartition(",")[0] + ",,"

    assert speed("\n".join(lines)).steps_per_s == pytest.approx(5.0, rel=0.05)


@pytest.mark.parametrize(
    "trace", [None, "", "\n".join(TRACE.splitlines()[:1]), TRACE.replace(",wall_clock", ",clock")]
)
def test_a_trace_that_shows_no_time_gives_no_speed(speed, trace):
    assert speed(trace) == UNKNOWN
