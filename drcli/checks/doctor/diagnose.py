"""Examines everything in less than ten seconds."""

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from drcli.base.errors import Problem, ProblemsError, of_severity
from drcli.base.files import read_json
from drcli.checks.doctor.bucket_health import (
    examine_bucket,
    examine_minio_folder,
    examine_upload_bucket,
)
from drcli.checks.doctor.findings import DoctorReport, Examination, Finding, Probe
from drcli.checks.doctor.leftovers import examine_runs, examine_server
from drcli.checks.doctor.libraries import (
    LearnerSettings,
    Libraries,
    ask_libraries,
    examine_extras,
    examine_gpus,
    examine_kernels,
    examine_packages,
    examine_processor,
    examine_trainer,
)
from drcli.checks.doctor.surroundings import (
    examine_confinement,
    examine_disks,
    examine_language,
    examine_limits,
    examine_memory,
    examine_place,
    examine_shell,
)
from drcli.checks.machine_rules import review_access
from drcli.checks.start_rules import start_problems
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.config.track_names import track_problems
from drcli.model.run_metadata import installed_versions
from drcli.workers.ray_extra import workers_here

LOCAL_S = 3.5
TOTAL_S = 8.5
"""The libraries may load until then."""

TIDY_S = 1.0
"""To delete a trial's objects."""

MOST_SETTINGS = 4


def diagnose(directory: Path) -> DoctorReport:
    """Examine installation, machine and bucket; the folder may lack settings."""
    began_s = time.monotonic()
    settings, about_settings = _settings(directory)
    # First the machine: what it computes meanwhile would slow the bucket down.
    here = Examination(_on_this_machine(directory, settings))
    here.wait(LOCAL_S)
    end_s = began_s + TOTAL_S
    there = Examination([] if settings is None else _buckets(settings, end_s - TIDY_S))
    for examination in (there, here):
        examination.wait(end_s - time.monotonic())
    there.wait(TIDY_S)
    findings = [*here.findings(), *about_settings, *there.findings()]
    return DoctorReport(str(directory), round(time.monotonic() - began_s, 1), tuple(findings))


def _settings(directory: Path) -> tuple[Settings | None, list[Finding]]:
    if not (directory / "run.env").is_file():
        text = f"there is no run.env in {directory}, so the bucket was not examined."
        remedy = "Change to your working folder, or create one with `dr init`."
        return None, [Finding("settings", "warning", text, remedy)]
    try:
        settings = load_settings(directory)
    except ProblemsError as error:
        found = _wrong(error.errors)
        more = len(error.errors) - len(found)
        text = f"the bucket was not examined{f'; {more} more settings are wrong' if more else ''}."
        return None, [*found, Finding("settings", "warning", text, "Correct the settings first.")]
    access = [
        Finding("settings", "warning", problem.message, problem.remedy)
        for problem in review_access(settings.storage, directory)
    ]
    problems = [*track_problems(settings.races), *start_problems(settings, here=True)]
    # A training that runs is told among the runs.
    errors = [each for each in of_severity(problems, "error") if each.rule != "V-13"]
    if errors:
        return settings, [*_wrong(errors), *access]
    names = {place.file for place in settings.sources.values() if place.line is not None}
    files = " and ".join(sorted(names)) or "no file"
    text = f"{len(settings.sources)} settings of {files} are right"
    odd = len(settings.problems)
    text += f"; {odd} remarks, which `dr config check` shows" if odd else ""
    return settings, [Finding("settings", "ok", text, facts={"warnings": odd}), *access]


def _wrong(errors: Sequence[Problem]) -> list[Finding]:
    return [
        Finding("settings", "problem", str(problem), problem.remedy)
        for problem in errors[:MOST_SETTINGS]
    ]


def _on_this_machine(directory: Path, settings: Settings | None) -> list[Probe]:
    storage = None if settings is None else settings.storage
    data_dir = storage.data_dir if storage is not None and storage.cloud == "local" else None
    workers = 1 if settings is None else workers_here(settings)
    probes = [
        Probe("Python", examine_packages),
        Probe("extras", examine_extras),
        Probe("kernels", examine_kernels),
        Probe("processor", examine_processor),
        Probe("trainer", lambda: _libraries(directory, settings)),
        Probe("memory", lambda: examine_memory(workers)),
        Probe("disk", lambda: examine_disks(directory, data_dir)),
        Probe("place", lambda: examine_place(os.environ)),
        Probe("limits", examine_limits),
        Probe("reward", examine_confinement),
        Probe("locale", lambda: examine_language(os.environ)),
        Probe("shell", lambda: examine_shell(directory, os.environ)),
        Probe("runs", lambda: examine_runs(directory)),
    ]
    if storage is not None:
        probes.append(Probe("server", lambda: examine_server(storage)))
    return probes


def _libraries(directory: Path, settings: Settings | None) -> Iterator[Finding]:
    wanted = LearnerSettings()
    if settings is not None:
        file = settings.custom_files_dir / "hyperparameters.json"
        wanted = LearnerSettings(
            settings.torch_precision, _batch_size(file), settings.sagemaker_cuda_devices
        )
    libraries: Libraries = ask_libraries(wanted)
    yield from examine_trainer(libraries)
    yield from examine_gpus(libraries, installed_versions(["torch"])["torch"], wanted.gpus)


def _batch_size(file: Path) -> int:
    """It decides the number format."""
    written = read_json(file)
    size = None if written is None else written.get("batch_size")
    return size if isinstance(size, int) and 0 < size < 1 << 20 else 64


def _buckets(settings: Settings, end_s: float) -> list[Probe]:
    return [
        Probe("bucket", lambda: examine_bucket(settings, end_s)),
        Probe("upload bucket", lambda: examine_upload_bucket(settings, end_s)),
        Probe("MinIO", lambda: examine_minio_folder(settings)),
    ]
