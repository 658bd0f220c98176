"""A racer with two buckets in memory: one of the working folder, one for uploads."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from drcli.bucket.bucket import Watch
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.transfer.download import DownloadOptions, DownloadReport, download, plan_download
from drcli.transfer.upload import UploadOptions, UploadReport, plan_upload, upload
from evaluations import evaluated
from iterations import iteration_record
from memory_bucket import MemoryBucket

RUN_ENV = (
    "DR_WORLD_NAME=reinvent_base",
    "DR_LOCAL_S3_MODEL_PREFIX=team/model",
    "DR_UPLOAD_S3_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX-1",
)


class Mover:
    """Makes models and moves them.

    Attributes:
        here: The bucket of the working folder.
        there: The bucket of uploads.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self._patch = monkeypatch
        (folder / "system.env").write_text("DR_UPLOAD_S3_BUCKET=uploads\n")
        self.run_env(*RUN_ENV)
        self.here = MemoryBucket("bucket")
        self.use(MemoryBucket("uploads"))
        monkeypatch.setattr(
            "drcli.transfer.transfer_buckets.open_running_bucket", lambda *_: self.here
        )
        for module in (
            "upload",
            "download",
            "transfer_buckets",
            "copy_custom_files",
        ):
            monkeypatch.setattr(f"drcli.transfer.{module}.open_bucket", lambda *_, **__: self.here)

    def use(self, there: MemoryBucket) -> None:
        """Take another bucket for uploads."""
        self.there = there
        self._patch.setattr(
            "drcli.transfer.transfer_buckets.open_upload_bucket", lambda *_, **__: self.there
        )

    def use_as_source(self) -> None:
        """Let addresses lead to the bucket of uploads."""
        self._patch.setattr("drcli.transfer.download.source_bucket", lambda *_, **__: self.there)

    def run_env(self, *lines: str) -> None:
        (self.folder / "run.env").write_text("\n".join(lines) + "\n")

    def settings(self) -> Settings:
        return load_settings(self.folder)

    def upload(self, **options: Any) -> UploadReport:
        settings = self.settings()
        planned = plan_upload(settings, UploadOptions(**options))
        return upload(planned, settings, no_bar)

    def download(self, url: str, prefix: str, **options: Any) -> DownloadReport:
        settings = self.settings()
        planned = plan_download(settings, DownloadOptions(url, prefix, **options))
        return download(planned, settings, no_bar)


@contextmanager
def no_bar(what: str, total: int) -> Iterator[Watch]:
    """Shows nothing."""
    yield lambda more: None


def put_model(
    bucket: MemoryBucket, prefix: str, *, design: str = "a", numbers: tuple[int, ...] = (3, 5)
) -> None:
    """Lay down a model whose best checkpoint is the first and whose last is the last number."""
    store = CheckpointStore(ModelStore(bucket, prefix))
    for number in numbers:
        weights = f"weights {number} of design {design}".encode()
        learned = iteration_record(number, kl=math.nan)  # as SAC has it
        counters = Counters(episodes=number, learned=learned)
        record = store.save(number, 100 * number, weights, counters=counters)
        store.record_evaluation(
            evaluated(record.name, 90.0 if number == numbers[0] else 50.0), "progress"
        )
    store.attach_optimizer(record, b"moments")
    bucket.put(keys.model_metadata(prefix), json.dumps({"design": design}).encode())
    bucket.put(keys.hyperparameters(prefix), b'{"lr": 0.001}')
    bucket.put(keys.reward_function(prefix), b"def reward_function(params): ...")
    bucket.put(keys.training_start(prefix), b'{"seed": 7}')
    bucket.put(keys.training_metrics(keys.metrics_prefix(prefix)), b'{"metrics": []}')
    bucket.put(keys.history(prefix), b'{"iterations": []}')
    bucket.put(keys.training_trace(prefix, 0), b"episode,steps")
    bucket.put(keys.log(prefix, "sagemaker", "trainer.log"), b"a log")
    bucket.put(keys.finished(prefix), b"")
    bucket.put(
        keys.parameter_file(prefix, "training_params.yaml"),
        b"WORLD_NAME: Oval_track\nSAGEMAKER_SHARED_S3_BUCKET: bucket\nS3_ENDPOINT_URL: http://x\n",
    )


def driven(bucket: MemoryBucket, prefix: str) -> str | None:
    """What somebody who takes the model there would drive: its weights and design.

    Returns:
        None where there is no model; that is said cleanly, by missing pointers.
    """
    store = CheckpointStore(ModelStore(bucket, prefix))
    best, last = store.best_name(), store.pointed()
    if best is None:
        return None
    assert last is not None
    store.load(str(last))
    weights = store.load(best).tensors.decode()
    design = json.loads(bucket.get(keys.model_metadata(prefix)))["design"]
    assert weights.endswith(f"of design {design}")
    return weights


@pytest.fixture
def mover(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Mover:
    """A racer with a model of two checkpoints, 3 (the best) and 5 (the last)."""
    mover = Mover(working_folder, monkeypatch)
    put_model(mover.here, "team/model")
    return mover


@pytest.fixture
def names() -> Callable[[MemoryBucket, str], list[str]]:
    """Names of all objects below a prefix."""

    def of(bucket: MemoryBucket, prefix: str) -> list[str]:
        folder = keys.folder(prefix)
        return [info.key.removeprefix(folder) for info in bucket.list(folder)]

    return of


@pytest.fixture
def exporter(mover: Mover, monkeypatch: pytest.MonkeyPatch) -> Mover:
    """A racer without a model yet, whose exports into buckets go to `there`."""
    mover.here.delete([info.key for info in mover.here.list("")])
    for module in ("export_model", "export_forms", "export_droa"):
        monkeypatch.setattr(f"drcli.transfer.{module}.open_bucket", lambda *_, **__: mover.here)
    monkeypatch.setattr("drcli.transfer.export_model.source_bucket", lambda *_, **__: mover.there)
    monkeypatch.chdir(mover.folder)
    return mover


@pytest.fixture
def small_checkpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exports have a few bytes instead of weights, for tests of all that is around them."""
    from drcli.transfer.export_forms import TrainingCheckpoint

    parts = {end: end.encode() for end in (".index", ".data-00000-of-00001", ".meta")}
    small = TrainingCheckpoint(parts, b"graph", 22, ["A note."])
    monkeypatch.setattr("drcli.transfer.export_forms.encode_training_checkpoint", lambda *_: small)
