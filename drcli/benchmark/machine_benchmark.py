"""Measures this machine's training speed."""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.installation import installation_error
from drcli.base.json_record import RecordError, from_json, json_default, parse_json
from drcli.base.memory_state import read_memory
from drcli.benchmark.bucket_speed import BucketSpeed, measure_bucket
from drcli.benchmark.estimate import TrainingEstimate, estimate, first_lap_s
from drcli.benchmark.measured_work import own_order, shipped_settings, standard_order
from drcli.benchmark.processor_use import ProcessorUse
from drcli.benchmark.spare_bucket import bucket_to_measure
from drcli.benchmark.work_order import Rates, Ready, WorkOrder
from drcli.checks.machine_rules import TRAINER_BYTES, WORKER_BYTES
from drcli.config import secret_environment
from drcli.config.loading import load_settings
from drcli.exchange.job import PROCESS_TUNING, THREAD_VARIABLES
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.models.run_metadata import processor_name

MOST_S = 58.0
BUCKET_S = 5.0
MEASURED_S = 12.0
"""Half for each of two trainings."""

LEAST_PROCESS_S = 12.0
BUSY_SHARE = 0.1
"""Above this, other programs make the numbers too low."""


@dataclass(frozen=True)
class WorkSpeed:
    """A measured training.

    Attributes:
        world: The track.
        race_type: DR_RACE_TYPE.
        network: neural_network of model_metadata.json.
        algorithm: training_algorithm of model_metadata.json.
        ready: What it uses here.
        rates: What was measured.
        estimate: What a training would do.
    """

    world: str
    race_type: str
    network: str
    algorithm: str
    ready: Ready
    rates: Rates
    estimate: TrainingEstimate


@dataclass(frozen=True)
class BucketReport:
    """A measured bucket.

    Attributes:
        place: Its kind and address.
        speed: What was measured.
    """

    place: str
    speed: BucketSpeed


@dataclass(frozen=True)
class BenchReport:
    """The result of `dr-bench`.

    Attributes:
        number: Steps per second of the standard training: to compare with the page.
        folder: The working folder; null without run.env.
        processor: Its name.
        cores: Cores of the machine.
        usable_cores: Cores for a training here.
        threads: DR_THREADS; 0 for all cores.
        priority: DR_PRIORITY.
        memory_bytes: Memory of machine or container, swap included.
        free_memory_bytes: Free before the measurement.
        needed_memory_bytes: Estimate for a training with DR_WORKERS.
        versions: Of drcli, Python and the libraries that compute.
        standard: The shipped files on reinvent_base, always measured.
        own: The files and track of the working folder, if they differ.
        own_left_out: Why they were not measured, or empty.
        bucket: Null if it was left out.
        first_lap_s: Seconds from the start of the standard training to its first evaluation lap:
            least, median and most.
        busy_share: Share of the processor that other programs used, 0 to 1.
        stolen_share: Share that the host of this virtual machine gave to others, 0 to 1.
        warnings: What makes the numbers uncertain.
        seconds: Length of the measurement.
    """

    number: float
    folder: str | None
    processor: str
    cores: int
    usable_cores: int
    threads: int
    priority: str
    memory_bytes: int
    free_memory_bytes: int
    needed_memory_bytes: int
    versions: dict[str, str]
    standard: WorkSpeed
    own: WorkSpeed | None
    own_left_out: str
    bucket: BucketReport | None
    first_lap_s: list[float]
    busy_share: float
    stolen_share: float
    warnings: list[str] = field(default_factory=list)
    seconds: float = 0.0


def measure_machine(
    folder: Path, *, with_bucket: bool, on_step: Callable[[str], None] = lambda text: None
) -> BenchReport:
    """Measure for about a minute, and leave nothing behind; run.env may be missing.

    Raises:
        SettingsError: A setting is wrong.
        StorageError: The bucket cannot be used.
        WorkerDied: The measuring process failed.
    """
    began_s = time.monotonic()
    has_settings = (folder / "run.env").is_file()
    settings = load_settings(folder, contents=None if has_settings else shipped_settings())
    memory = read_memory()
    usage = ProcessorUse()
    bucket: BucketReport | None = None
    if with_bucket:
        on_step("Measuring the bucket ...")
        with bucket_to_measure(settings, temporary=not has_settings) as (place, opened):
            bucket = BucketReport(place, measure_bucket(opened, BUCKET_S))
    standard_work = standard_order(settings, folder)
    own_work, left_out = own_order(settings, standard_work) if has_settings else (None, "")

    def left_s() -> float:
        return max(LEAST_PROCESS_S, began_s + MOST_S - time.monotonic())

    speed = bucket.speed if bucket else None
    works = 2 if own_work else 1
    seconds = MEASURED_S / works
    on_step("Measuring a training with the shipped files ...")
    standard = _measured(standard_work, seconds, left_s() / works, speed)
    own = None
    if own_work is not None:
        on_step("Measuring a training with your files ...")
        try:
            own = _measured(own_work, seconds, left_s(), speed)
        except (SettingsError, WorkerDied) as error:
            left_out = f"{error} {error.remedy}"
    busy, stolen = usage.of_others()
    report = BenchReport(
        number=round(standard.estimate.training_steps_per_s, 1),
        folder=str(folder) if has_settings else None,
        processor=processor_name(),
        cores=os.cpu_count() or 1,
        usable_cores=max(standard.ready.driving_threads, standard.ready.learning_threads),
        threads=settings.threads,
        priority=settings.priority,
        memory_bytes=memory.total_bytes,
        free_memory_bytes=memory.available_bytes,
        needed_memory_bytes=settings.workers * WORKER_BYTES + TRAINER_BYTES,
        versions={"python": platform.python_version()}
        | {name: version(name) for name in ("drcli", "torch", "numpy", "mujoco")},
        standard=standard,
        own=own,
        own_left_out=left_out,
        bucket=bucket,
        first_lap_s=[round(s, 1) for s in first_lap_s(standard.ready, standard.rates, speed)],
        busy_share=round(busy, 3),
        stolen_share=round(stolen, 3),
        seconds=round(time.monotonic() - began_s, 1),
    )
    return replace(report, warnings=list(_warnings(report)))


def _warnings(report: BenchReport) -> Iterator[str]:
    if report.busy_share > BUSY_SHARE:
        yield (
            f"The machine is busy: other programs used {100 * report.busy_share:.0f} % of its "
            "processor meanwhile, so the numbers are too low. Stop them and measure again."
        )
    if report.stolen_share > BUSY_SHARE:
        yield (
            f"The host of this virtual machine gave {100 * report.stolen_share:.0f} % of its "
            "processor to others."
        )
    if report.free_memory_bytes < report.needed_memory_bytes:
        yield (
            f"Only {report.free_memory_bytes / 1e9:.1f} GB of memory are free; a training needs "
            f"about {report.needed_memory_bytes / 1e9:.1f} GB."
        )


def _measured(
    order: WorkOrder, seconds: float, most_s: float, bucket: BucketSpeed | None
) -> WorkSpeed:
    metadata = ModelMetadata.from_bytes(order.metadata.encode())
    ready, rates = _ask(replace(order, seconds=seconds, most_seconds=most_s), most_s)
    return WorkSpeed(
        world=order.race.world_name,
        race_type=order.race.race_type,
        network=metadata.neural_network,
        algorithm=metadata.training_algorithm,
        ready=ready,
        rates=rates,
        estimate=estimate(ready, rates, bucket),
    )


def _ask(order: WorkOrder, most_s: float) -> tuple[Ready, Rates]:
    plain, _ = secret_environment.split(os.environ)
    limits = (
        dict.fromkeys(THREAD_VARIABLES, str(order.train.threads)) if order.train.threads else {}
    )
    gpus = order.train.sagemaker_cuda_devices
    chosen = {"CUDA_VISIBLE_DEVICES": gpus} if gpus else {}
    data = json.dumps(asdict(order), default=json_default).encode()
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "drcli.benchmark.measure_process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**PROCESS_TUNING, **plain, **limits, **chosen},
        start_new_session=True,
    )
    try:
        out, err = process.communicate(data, timeout=most_s + LEAST_PROCESS_S)
    except subprocess.TimeoutExpired:
        raise WorkerDied(
            f"The measurement was not done after {most_s + LEAST_PROCESS_S:.0f} s.",
            remedy="Run `dr-bench` again when the machine is less busy.",
        ) from None
    finally:
        process.kill()
        process.wait()
    answers: dict[str, object] = {}
    with suppress(RecordError):
        for line in out.splitlines():
            said = parse_json(line)
            answers |= said if isinstance(said, dict) else {}
    try:
        return from_json(Ready, answers["Ready"]), from_json(Rates, answers["Rates"])
    except (KeyError, RecordError):
        lines = err.decode("utf-8", "replace").strip().splitlines()
        why = lines[-1] if lines else f"it ended with exit code {process.returncode}"
        raise installation_error() or WorkerDied(
            f"The measuring process failed: {why}",
            remedy="Run `dr-doctor`, which examines the installation; `dr-validate` checks your "
            "files.",
        ) from None
