"""Runs and working folders as the commands meet them."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from amazon_server import amazon_server
from bucket_server import without_server
from drcli.base.log import LogFile
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.cli.app import main
from drcli.config.run_config import StorageConfig
from drcli.model.model_list import CheckpointEntry
from drcli.records.iteration import IterationRecord, Laps
from drcli.records.scores import Score
from drcli.run.evaluation_report import EvaluationReport, TrialReport
from drcli.run.status import CheckpointLaps, RunReport, WorkerReport
from evaluations import evaluated
from memory_bucket import MemoryBucket
from racer import Racer

BEST_LAPS_S = [14.0 + k / 10 for k in range(18)]
"""Clean ones of the best checkpoint, of 20."""

STARTED_S = 1_000_000.0
"""When every made-up run began."""


@pytest.fixture
def make_record() -> Callable[..., IterationRecord]:
    """Iteration n of a training that gets better by 3 % each time."""

    def make(n: int, **changes: Any) -> IterationRecord:
        completed = max(0, min(3, n - 5))
        fields: dict[str, Any] = {
            "iteration": n,
            "checkpoint": f"{n}_Step-{n * 500}.ckpt",
            "episodes": 20,
            "steps": 500,
            "total_steps": (n + 1) * 500,
            "mean_reward": 10.0 + 4.0 * n,
            "mean_progress": 10.0 + 3.0 * n,
            "full_laps": n,
            "best_lap_s": 14.25 if n else None,
            "entropy": 2.5 - 0.05 * n,
            "surrogate_loss": -0.0123,
            "value_loss": 0.45,
            "kl": 0.0021,
            "steps_per_s": 370.0,
            "real_time_factor": 25.0,
            "drive_s": 0.6,
            "learn_s": 0.7,
            "exchange_s": 0.1,
            "elapsed_s": 1.4 * (n + 1),
            "evaluation_progress": [100.0] * completed + [40.0] * (3 - completed),
            "evaluation_lap_s": [14.5] * completed,
        }
        return IterationRecord(**{**fields, **changes})

    return make


@pytest.fixture
def make_report(make_record: Callable[..., IterationRecord]) -> Callable[..., RunReport]:
    """A run on one simulation worker with so many iterations behind it."""

    def make(state: str = "running", iterations: int = 0, **changes: Any) -> RunReport:
        alive = state in ("starting", "running")
        history = [make_record(n) for n in range(iterations)]
        if history and alive:
            history[-1] = make_record(iterations - 1, evaluation_progress=[], evaluation_lap_s=[])
        activities = {"trainer": f"waits for rollouts of iteration {iterations}"}
        activities["sim-0"] = f"drives iteration {iterations}"
        fields: dict[str, Any] = {
            "run_id": 0,
            "bucket": "bucket",
            "prefix": "model",
            "world": "reinvent_base",
            "state": state,
            "message": "" if alive else "All 3 evaluation laps are complete.",
            "exit_code": None if alive else 0,
            "started_at": STARTED_S,
            "elapsed_s": 1.4 * iterations,
            "pid": 4242,
            "workers": [
                WorkerReport(name, 4243, alive, 0, said if alive else "", f"/logs/{name}.log")
                for name, said in activities.items()
            ],
            "history": history,
            "best": CheckpointEntry.of(
                Score("8_Step-4000.ckpt", 100.0), "progress", Laps(20, BEST_LAPS_S)
            )
            if iterations
            else None,
            "newest_laps": CheckpointLaps.of(7, Laps(20, BEST_LAPS_S[:9])) if iterations else None,
            "best_laps": CheckpointLaps.of(8, Laps(20, BEST_LAPS_S)) if iterations else None,
            "last": CheckpointEntry(f"{iterations}_Step-{iterations * 500}.ckpt", None)
            if iterations
            else None,
        }
        return RunReport(**{**fields, **changes})

    return make


@pytest.fixture
def evaluation_report() -> EvaluationReport:
    """Two laps of three."""
    return EvaluationReport(
        prefix="model",
        world="reinvent_base",
        checkpoint="8_Step-4000.ckpt",
        trials=[
            TrialReport(1, 100.0, 13.4211, "Lap complete", 0, 0, 0),
            TrialReport(2, 100.0, 15.0, "Lap complete", 1, 0, 1),
            TrialReport(3, 37.4, 6.2, "Off track", 1, 0, 0),
        ],
        simtrace="model/evaluation-1/0-iteration.csv",
        metrics="model/metrics/evaluation-1.json",
    )


@pytest.fixture
def working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A racer's folder, current, with nothing of this process's own settings.

    A command may have started the bucket's server; it ends with the test.
    """
    for name in os.environ:
        if name.startswith("DR_"):
            monkeypatch.delenv(name)
    (tmp_path / "system.env").write_text("DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\n")
    (tmp_path / "run.env").write_text(
        "DR_WORLD_NAME=reinvent_base\nDR_LOCAL_S3_MODEL_PREFIX=model\nDR_WORKERS=2\n"
    )
    monkeypatch.chdir(tmp_path)
    with without_server(tmp_path):
        yield tmp_path


@pytest.fixture
def dr() -> Callable[..., int]:
    """Runs a command line in this process and returns its exit code."""

    def run(*arguments: str) -> int:
        with pytest.raises(SystemExit) as end:
            main(list(arguments))
        assert isinstance(end.value.code, int)
        return end.value.code

    return run


@pytest.fixture
def logged(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], str]]:
    """What has been written into the log of this process."""
    path = tmp_path_factory.mktemp("log") / "test.log"
    log = LogFile(path, 1 << 20)
    yield path.read_text
    log.end()


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Warnings that commands show while they work."""
    said: list[str] = []
    monkeypatch.setattr("drcli.base.errors.warn", said.append)
    return said


@pytest.fixture
def racer(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Racer:
    """A racer in an empty folder, the current one."""
    bucket = MemoryBucket()
    for module in ("plan", "increment", "resume_or_start"):
        monkeypatch.setattr(f"drcli.run.{module}.open_bucket", lambda *_, **__: bucket)
    monkeypatch.setattr("drcli.checks.before_start.try_inputs", lambda *_: [])
    return Racer(working_folder, bucket)


@pytest.fixture
def trained(racer: Racer) -> Racer:
    """The same with a trained model-1: its best checkpoint is 3, its last one 5."""
    racer.start()
    store = racer.store("model-1")
    for number in range(6):
        store.save(number, 100 * number, b"weights %d" % number, optimizer=b"moments")
        store.record_evaluation(
            evaluated(f"{number}_Step-{number}00.ckpt", 90.0 if number == 3 else 50.0), "progress"
        )
    return racer


# Buckets: in memory, over the wire to moto, and on a real rclone server.


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
