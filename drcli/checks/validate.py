"""All rules on a working folder, whatever is in it: what `dr validate` reports."""

import os
import secrets
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from drcli.base.errors import SettingsError, StorageError
from drcli.base.problems import Finding
from drcli.checks.before_start import FILE_RULES, Examined, Plans, examine
from drcli.checks.check_report import Report, Skipped, Violation, by_severity, of_severity
from drcli.checks.compatibility import as_console, review_actions, review_balance, review_names
from drcli.checks.console_rules import review_style
from drcli.checks.machine_rules import review_gpu, review_memory
from drcli.checks.parameter_rules import review_parameters
from drcli.checks.reward_rules import read_source, review_source
from drcli.checks.settings_rules import SettingsReview, review_settings
from drcli.checks.storage_rules import probe, review_rivals
from drcli.checks.translation import from_error
from drcli.config.settings import Settings
from drcli.config.worlds import fetchable
from drcli.exchange.job import Job
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.modelfiles.custom_files import InputFile, find
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import open_bucket

PATIENCE_S = 5.0
"""How long to wait for a bucket that does not answer."""

BUCKET_RULES = ("V-09", "V-10", "V-13", "V-35", "V-50")


def validate(
    directory: Path,
    *,
    console_compatible: bool = False,
    environ: Mapping[str, str] | None = None,
) -> Report:
    """Try all rules and report everything that is wrong or odd; nothing in the folder changes.

    Args:
        directory: The racer's working folder.
        console_compatible: Whether the model shall train on a DeepRacer console too: then what a
            console refuses is an error.
        environ: Process environment; `os.environ` when None.
    """
    directory = directory.absolute()
    reviewed = review_settings(directory, environ)
    found, skipped = list(reviewed.violations), list[Skipped]()
    if reviewed.settings is None:
        found += _files_alone(directory, skipped)
    else:
        found += _with_settings(reviewed, reviewed.settings, skipped, console_compatible)
    devices = reviewed.settings.sagemaker_cuda_devices if reviewed.settings else ""
    found += review_gpu(devices, os.environ if environ is None else environ)
    told = [_relative(item, directory) for item in found]
    errors, warnings = by_severity(told)
    notes = of_severity(told, "note")
    return Report(str(directory), console_compatible, errors, warnings, tuple(skipped), notes)


def _with_settings(
    reviewed: SettingsReview, settings: Settings, skipped: list[Skipped], console: bool
) -> list[Violation]:
    directory = settings.directory
    found: list[Violation] = []
    record = RunRecord.read(run_folder(directory, settings.run_id))
    trains = record is not None and record.alive
    if record is not None and trains:
        found.append(
            Violation(
                "V-13",
                "warning",
                settings.source("DR_RUN_ID"),
                f"Run {settings.run_id} is training s3://{record.bucket}/{record.prefix} "
                f"(process {record.pid}).",
                "Stop it with `dr-stop-training` before the next start, or change DR_RUN_ID.",
            )
        )
    bucket = _bucket(reviewed, settings, found, skipped, trains=trains)
    files = _files(settings, bucket, found, skipped)
    examined = _examined(settings, files, bucket, found, skipped, trains=trains)
    found += review_names(settings, console=console)
    if examined.source is not None:
        found += review_style(examined.source, console=console)
    parameters, metadata = examined.review.parameters, examined.review.metadata
    if metadata is not None:
        where = files[keys.MODEL_METADATA_FILE].origin
        found += review_actions(metadata, parameters, settings, where, console=console)
    if console:
        found = [as_console(item) for item in found]
    if parameters is not None:
        found += review_balance(settings, parameters, files[keys.HYPERPARAMETERS_FILE].origin)
    found += review_memory(settings.workers, settings.source("DR_WORKERS"), parameters, metadata)
    return found


def _bucket(
    reviewed: SettingsReview,
    settings: Settings,
    found: list[Violation],
    skipped: list[Skipped],
    *,
    trains: bool,
) -> Bucket | None:
    """The bucket, if it can be used; what is wrong with it goes to the findings."""
    if not reviewed.whole:
        reason = "The bucket is not asked before the settings are right."
        skipped.append(Skipped(BUCKET_RULES, reason))
        return None
    try:
        bucket = open_bucket(settings.storage, patience_s=PATIENCE_S)
        bucket.probe()
        wrong = probe(bucket)
        if not trains:
            wrong += review_rivals(settings.model_prefix, bucket)
    except StorageError as error:
        place = settings.source("DR_CLOUD")
        wrong = [Violation("V-50", "error", place, str(error), error.remedy)]
    found += wrong
    if any(item.severity == "error" for item in wrong):
        skipped.append(Skipped(BUCKET_RULES[:-1], "The bucket cannot be used."))
        return None
    return bucket


def _files(
    settings: Settings, bucket: Bucket | None, found: list[Violation], skipped: list[Skipped]
) -> dict[str, InputFile]:
    try:
        files = find(settings.custom_files, bucket)
    except SettingsError as error:
        found += from_error(error, lambda _: "V-02")
        files = {}
    except StorageError as error:
        found.append(Violation("V-50", "error", "", str(error), error.remedy))
        files = {}
    if bucket is None:
        unseen = [name for name in FILE_RULES if name not in files]
        rules = tuple(FILE_RULES[name] for name in unseen)
        if unseen:
            reason = f"{', '.join(unseen)} may lie in the bucket, which cannot be read."
            skipped.append(Skipped(rules, reason))
    return files


def _examined(
    settings: Settings,
    files: Mapping[str, InputFile],
    bucket: Bucket | None,
    found: list[Violation],
    skipped: list[Skipped],
    *,
    trains: bool,
) -> Examined:
    """The rules of the start, in a folder that no training uses."""
    with tempfile.TemporaryDirectory() as folder:
        job = Job(
            config=settings.run,
            session=secrets.token_hex(6),
            seed=0,
            until_laps=None,
            max_minutes=None,
            folder=Path(folder),
            launcher_pid=os.getpid(),
        )
        plans = Plans(wiping=trains)  # a model that is being trained lies where it should
        try:
            examined = examine(settings, job, files, bucket, plans)
        except StorageError as error:
            found.append(Violation("V-50", "error", "", str(error), error.remedy))
            skipped.append(Skipped(BUCKET_RULES[:-1], "The bucket failed meanwhile."))
            examined = examine(settings, job, files, None, plans)
    to_come = {finding.where: finding for finding in fetchable(settings.races)}
    found += [_told_without_start(item, to_come) for item in examined.violations]
    return examined


def _told_without_start(item: Violation, to_come: Mapping[str, Finding]) -> Violation:
    """What a start would refuse or ask about is no fault where nothing is started."""
    if item.rule == "V-09":
        return replace(item, severity="note", message=f"There is a model at {item.where}.")
    if item.rule == "V-05" and item.where in to_come:
        track = to_come[item.where]
        return replace(item, severity="note", message=f"{track.what}.", remedy=track.remedy)
    return item


def _files_alone(directory: Path, skipped: list[Skipped]) -> list[Violation]:
    """What can be said about the three files where no settings say which bucket and track."""
    found: list[Violation] = []
    files = {
        name: InputFile(name, path.read_bytes(), str(path))
        for name in FILE_RULES
        if (path := directory / "custom_files" / name).is_file()
    }
    reward = files.get(keys.REWARD_FUNCTION_FILE)
    if reward is not None:
        source, wrong = read_source(reward)
        found += wrong if source is None else review_source(source)
    found += review_parameters(
        files.get(keys.HYPERPARAMETERS_FILE), files.get(keys.MODEL_METADATA_FILE), None
    ).violations
    skipped.append(
        Skipped(
            ("V-05", "V-20", "V-21", *BUCKET_RULES),
            "Track and bucket are not known before the settings are right.",
        )
    )
    return found


def _relative(item: Violation, directory: Path) -> Violation:
    """The same with places inside the folder named from there."""
    start = f"{directory}{os.sep}"
    texts = (text.replace(start, "") for text in (item.where, item.message, item.remedy))
    return Violation(item.rule, item.severity, *texts)
