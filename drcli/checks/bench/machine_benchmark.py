"""Measures this machine's training speed."""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import psutil

from drcli.base.errors import ProblemsError, SettingsError, WorkerDied
from drcli.base.installation import installation_error
from drcli.base.json_record import RecordError, decode_json, from_json, json_default
from drcli.base.memory import read_memory
from drcli.base.report import View, bold, counted
from drcli.checks.bench.bucket_speed import BucketSpeed, bucket_to_measure, measure_bucket
from drcli.checks.bench.work_order import Rates, Ready, WorkOrder
from drcli.checks.machine_rules import TRAINER_BYTES, WORKER_BYTES
from drcli.config import secret_environment
from drcli.config.loading import load_settings
from drcli.config.presets import model_file, settings_file
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.files.custom_files import local_file
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.run_metadata import processor_name
from drcli.records.job import PROCESS_TUNING, THREAD_VARIABLES

# Estimates a training from measured rates.


Part = Literal["driving", "learning", "bucket"]

ITERATION_STEPS = 2000
"""20 episodes over a third of `reinvent_base`."""

FIRST_LAP_STEPS = (418, 1878, 4266)
"""Least, median and most until a checkpoint completed an evaluation lap, shipped files, 20 seeds.
Source: docs/benchmarks.md.
"""

FIRST_ITERATION_STEPS = 750
REQUESTS = 14
"""Those that somebody waits for in an iteration."""

POLL_S = 0.1
"""How late pointers are noticed, per iteration."""

EVALUATION_SHARE = 1.1
"""For DR_TRAIN_EVAL_SHARE, a twentieth of all time."""


@dataclass(frozen=True)
class TrainingEstimate:
    """What a training would do with nothing else on the machine."""

    training_steps_per_s: Annotated[float, "Steps driven, sent and learned from per second."]
    driving_s: Annotated[float, "Time of driving an iteration of `ITERATION_STEPS` steps."]
    learning_s: Annotated[float, "Time of its update."]
    bucket_s: Annotated[float, "Time that its exchange through the bucket adds; 0 if unmeasured."]
    limited_by: Annotated[Part, "What takes longest: driving, learning or bucket."]
    limiting_share: Annotated[float, "Its share of an iteration."]


def estimate(ready: Ready, rates: Rates, bucket: BucketSpeed | None) -> TrainingEstimate:
    parts = _parts(ITERATION_STEPS, ready, rates, bucket)
    total_s = _total_s(parts, overlaps=ready.overlaps)
    limit = max(parts, key=lambda part: parts[part])
    return TrainingEstimate(
        training_steps_per_s=ITERATION_STEPS / total_s,
        driving_s=parts["driving"],
        learning_s=parts["learning"],
        bucket_s=parts["bucket"],
        limited_by=limit,
        limiting_share=min(1.0, parts[limit] / total_s),
    )


def first_lap_s(
    ready: Ready, rates: Rates, bucket: BucketSpeed | None
) -> tuple[float, float, float]:
    parts = _parts(FIRST_ITERATION_STEPS, ready, rates, bucket)
    iteration_s = _total_s(parts, overlaps=ready.overlaps)
    least, median, most = (
        ready.prepared_s + steps / FIRST_ITERATION_STEPS * iteration_s for steps in FIRST_LAP_STEPS
    )
    return least, median, most


def _parts(steps: int, ready: Ready, rates: Rates, bucket: BucketSpeed | None) -> dict[Part, float]:
    exchange_s = 0.0
    if bucket is not None:
        megabytes = (steps * rates.step_bytes + ready.weight_bytes) / 1e6
        transfer_s = megabytes / bucket.put_mb_per_s + megabytes / bucket.get_mb_per_s
        exchange_s = transfer_s + REQUESTS * bucket.request_ms / 1000 + POLL_S
    return {
        "driving": EVALUATION_SHARE * steps / rates.driving_steps_per_s,
        "learning": steps * ready.epochs / rates.learning_samples_per_s,
        "bucket": exchange_s,
    }


def _total_s(parts: dict[Part, float], *, overlaps: bool) -> float:
    if overlaps:
        return max(parts["driving"], parts["learning"]) + parts["bucket"]
    return sum(parts.values())


# Trainings that `dr-bench` measures.


_FILES = (keys.HYPERPARAMETERS_FILE, keys.MODEL_METADATA_FILE)


def standard_order(settings: Settings, folder: Path) -> WorkOrder:
    """Shipped files, with the processor settings of the folder; the caller sets the times."""
    flags = {"DR_EXPERIMENT_NAME": ""}
    shipped = load_settings(folder, environ={}, flags=flags, contents=shipped_settings()).run
    own = settings.run.train
    train = shipped.train.replaced(
        priority=own.priority,
        threads=own.threads,
        torch_precision=own.torch_precision,
        sagemaker_cuda_devices=own.sagemaker_cuda_devices,
        worker_device=own.worker_device,
    )
    files = {name: model_file(name).read_text("utf-8") for name in _FILES}
    return WorkOrder(
        race=shipped.race(),
        train=train,
        hyperparameters=files[keys.HYPERPARAMETERS_FILE],
        metadata=files[keys.MODEL_METADATA_FILE],
        reward_file=str(model_file(keys.REWARD_FUNCTION_FILE)),
        seconds=0.0,
        most_seconds=0.0,
    )


def shipped_settings() -> dict[str, bytes]:
    return {name: settings_file(name).read_bytes() for name in ("run.env", "system.env")}


def own_order(settings: Settings, standard: WorkOrder) -> tuple[WorkOrder | None, str]:
    """If it differs from the standard one; else why it is left out."""
    folder = settings.custom_files_dir
    texts = dict(zip(_FILES, (standard.hyperparameters, standard.metadata), strict=True))
    reward = Path(standard.reward_file)
    if settings.untrainable is not None:
        return None, str(settings.untrainable)
    try:
        for name in texts:
            found = local_file(folder, name)
            if found is not None:
                texts[name] = found.data.decode("utf-8-sig")
        Hyperparameters.from_bytes(texts[keys.HYPERPARAMETERS_FILE].encode())
        ModelMetadata.from_bytes(texts[keys.MODEL_METADATA_FILE].encode())
    except (ProblemsError, SettingsError, UnicodeDecodeError) as error:
        return None, str(error).splitlines()[0]
    if (folder / keys.REWARD_FUNCTION_FILE).is_file():
        reward = folder / keys.REWARD_FUNCTION_FILE
    order = replace(
        standard,
        race=settings.race,
        train=settings.run.train,
        hyperparameters=texts[keys.HYPERPARAMETERS_FILE],
        metadata=texts[keys.MODEL_METADATA_FILE],
        reward_file=str(reward),
    )
    same_reward = reward.read_bytes() == Path(standard.reward_file).read_bytes()
    return (None if same_reward and _same_work(order, standard) else order), ""


def _same_work(one: WorkOrder, other: WorkOrder) -> bool:
    def facts(order: WorkOrder) -> tuple[object, ...]:
        race = {k: v for k, v in order.race.to_json().items() if k not in ("directory", "sources")}
        return race, json.loads(order.hyperparameters), json.loads(order.metadata)

    return facts(one) == facts(other)


# Other use of the processor during a measurement.


class ProcessorUse:
    def __init__(self) -> None:
        self._all, self._own_s = self._read()

    def of_others(self) -> tuple[float, float]:
        """Shares of other programs, and of what the host took."""
        now, own_s = self._read()
        passed = {name: now[name] - self._all[name] for name in now}
        total_s = max(1e-9, sum(passed.values()))
        idle_s = passed.get("idle", 0.0) + passed.get("iowait", 0.0)
        stolen_s = passed.get("steal", 0.0)
        others_s = total_s - idle_s - stolen_s - (own_s - self._own_s)
        return max(0.0, others_s / total_s), max(0.0, stolen_s / total_s)

    @staticmethod
    def _read() -> tuple[Mapping[str, float], float]:
        times = psutil.cpu_times()._asdict()
        for part in ("guest", "guest_nice"):  # counted in user and nice already
            times.pop(part, None)
        spent = os.times()
        own_s = spent.user + spent.system + spent.children_user + spent.children_system
        return times, own_s


MOST_S = 58.0
BUCKET_S = 5.0
MEASURED_S = 12.0
"""Half for each of two trainings."""

LEAST_PROCESS_S = 12.0
BUSY_SHARE = 0.1
"""Above this, other programs make the numbers too low."""


_LIMITS = {
    "driving": "driving: more or faster cores would help",
    "learning": "learning: more or faster cores, or a GPU, would help",
    "bucket": "the bucket: one on this machine (DR_CLOUD=local) or nearer would help",
}


@dataclass(frozen=True)
class WorkSpeed:
    """A measured training."""

    world: Annotated[str, "The track."]
    race_type: Annotated[str, "DR_RACE_TYPE."]
    network: Annotated[str, "neural_network of model_metadata.json."]
    algorithm: Annotated[str, "training_algorithm of model_metadata.json."]
    ready: Annotated[Ready, "What it uses here."]
    rates: Annotated[Rates, "What was measured."]
    estimate: Annotated[TrainingEstimate, "What a training would do."]

    def parts(self, title: str) -> View:
        ready, rates, estimate = self.ready, self.rates, self.estimate
        where = "" if ready.device == "cpu" else f" on {ready.device}"
        rows = {
            "simulation": f"{rates.simulation_steps_per_s:,.0f} steps/s; with the policy "
            f"{rates.driving_steps_per_s:,.0f} steps/s ({rates.driving_steps_per_core_s:,.0f} per "
            f"second of a core), {ready.cars} cars, {counted(ready.driving_threads, 'thread')}",
            "learner": f"{rates.gradient_steps_per_s:,.1f} gradient steps/s, "
            f"{rates.learning_samples_per_s:,.0f} samples/s "
            f"({rates.learning_samples_per_core_s:,.0f} per second of a core), "
            f"{ready.number_format}{where}, {counted(ready.learning_threads, 'thread')}",
            "memory": f"{rates.memory_bytes / 1e6:,.0f} MB for both in one process",
            "training": f"{estimate.training_steps_per_s:,.0f} steps/s; limited by "
            f"{_LIMITS[estimate.limited_by]} ({100 * estimate.limiting_share:.0f} % of the time)",
        }
        race = f"{self.algorithm}, {self.network} on {self.world}, {self.race_type}"
        return f"{title}: {race}", [rows]


@dataclass(frozen=True)
class BucketReport:
    """A measured bucket."""

    place: Annotated[str, "Its kind and address."]
    speed: Annotated[BucketSpeed, "What was measured."]

    def __str__(self) -> str:
        speed = self.speed
        return (
            f"{self.place}; {speed.put_mb_per_s:,.1f} MB/s written, {speed.get_mb_per_s:,.1f} MB/s "
            f"read, {speed.requests_per_s:,.0f} requests/s one after the other "
            f"({speed.request_ms:.1f} ms each)"
        )


@dataclass(frozen=True)
class BenchReport:
    """The result of `dr-bench`."""

    number: Annotated[float, "Steps per second of the standard training: to compare with the page."]
    folder: Annotated[str | None, "The working folder; null without run.env."]
    processor: Annotated[str, "Its name."]
    cores: Annotated[int, "Cores of the machine."]
    usable_cores: Annotated[int, "Cores for a training here."]
    threads: Annotated[int, "DR_THREADS; 0 for all cores."]
    priority: Annotated[str, "DR_PRIORITY."]
    memory_bytes: Annotated[int, "Memory of machine or container, swap included."]
    free_memory_bytes: Annotated[int, "Free before the measurement."]
    needed_memory_bytes: Annotated[int, "Estimate for a training with DR_WORKERS."]
    versions: Annotated[dict[str, str], "Of drcli, Python and the libraries that compute."]
    standard: Annotated[WorkSpeed, "The shipped files on reinvent_base, always measured."]
    own: Annotated[WorkSpeed | None, "The files and track of the working folder, if they differ."]
    own_left_out: Annotated[str, "Why they were not measured, or empty."]
    bucket: Annotated[BucketReport | None, "Null if it was left out."]
    first_lap_s: Annotated[
        list[float],
        "Seconds from the start of the standard training to its first evaluation lap: "
        "least, median and most.",
    ]
    busy_share: Annotated[float, "Share of the processor that other programs used, 0 to 1."]
    stolen_share: Annotated[
        float, "Share that the host of this virtual machine gave to others, 0 to 1."
    ]
    warnings: Annotated[list[str], "What makes the numbers uncertain."] = field(
        default_factory=list
    )
    seconds: Annotated[float, "Length of the measurement."] = 0.0

    def view(self) -> View:
        cores = counted(self.cores, "core")
        if self.usable_cores < self.cores:
            cores = f"{self.usable_cores} of {cores} used"
        if self.threads:
            cores += f" (DR_THREADS={self.threads})"
        if self.priority == "low":
            cores += ", low priority (DR_PRIORITY)"
        free, total = self.free_memory_bytes / 1e9, self.memory_bytes / 1e9
        needed = f"a training needs about {self.needed_memory_bytes / 1e9:.1f} GB"
        least, median, most = self.first_lap_s
        first_lap = f"about {median:,.0f} s after the start with the shipped files"
        return [
            {
                "processor": f"{self.processor}, {cores}",
                "memory": f"{free:.1f} of {total:.1f} GB free; {needed}",
                "versions": ", ".join(f"{name} {number}" for name, number in self.versions.items()),
            },
            *self.standard.parts("shipped files"),
            *([] if self.own is None else self.own.parts("your files")),
            self.own_left_out and f"your files: not measured: {self.own_left_out}",
            {
                "bucket": "" if self.bucket is None else str(self.bucket),
                "first lap": f"{first_lap}, {least:,.0f} to {most:,.0f} s depending on the seed",
            },
            (
                bold(f"{self.number:,.0f} training steps/s"),
                ": the number to compare with `dr docs bench`",
            ),
            f"Measured in {self.seconds:.0f} s.",
        ]


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
        [sys.executable, "-P", "-m", "drcli.checks.bench.measure_process"],
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
            answers |= decode_json(dict[str, Any], line)
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
