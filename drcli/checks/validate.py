"""Checks all rules on a working folder, for `dr validate`."""

import os
import secrets
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.base.problems import Problem, ProblemsError, of_severity
from drcli.checks.before_start import Examined, Plans, examine
from drcli.checks.check_report import Report, Skipped
from drcli.checks.compatibility_rules import review_actions, review_balance, review_names
from drcli.checks.machine_rules import review_gpu, review_memory
from drcli.checks.parameter_rules import review_parameters
from drcli.checks.reward_rules import read_source, review_source
from drcli.checks.reward_style import review_style
from drcli.checks.settings_rules import SettingsReview, review_settings
from drcli.checks.stage_rules import review_stages
from drcli.checks.storage_rules import probe, review_owner
from drcli.config.settings import Settings
from drcli.config.track_names import track_problems
from drcli.exchange.job import Job
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.modelfiles.custom_files import FILE_RULES, InputFile, find, local_file
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.workers.ray_extra import workers_here

BUCKET_RULES = ("V-09", "V-10", "V-13", "V-35", "V-50")


def validate(
    directory: Path,
    *,
    console_compatible: bool = False,
    environ: Mapping[str, str] | None = None,
    reviewed: SettingsReview | None = None,
) -> Report:
    """Check all rules and report all problems; nothing in the folder changes.

    Args:
        directory: The racer's working folder.
        console_compatible: Whether the model is also meant for training on a DeepRacer console;
            anything that a console refuses is then an error.
        environ: Process environment; `os.environ` when None.
        reviewed: The settings, if they have been read already.
    """
    directory = directory.absolute()
    environ = os.environ if environ is None else environ
    reviewed = reviewed or review_settings(directory, environ)
    validation = _Validation(directory, console_compatible, list(reviewed.problems))
    if reviewed.settings is None:
        validation.try_files_alone()
    else:
        validation.try_everything(reviewed.settings, whole=reviewed.whole)
    found = [_relative(each, directory) for each in validation.found]
    devices = reviewed.settings.sagemaker_cuda_devices if reviewed.settings else ""
    found += review_gpu(devices, environ)
    return Report(
        str(directory),
        console_compatible,
        of_severity(found, "error"),
        of_severity(found, "warning"),
        tuple(validation.skipped),
        of_severity(found, "note"),
    )


@dataclass
class _Validation:
    """Collects the problems and the skipped rules."""

    directory: Path
    console: bool
    found: list[Problem]
    skipped: list[Skipped] = field(default_factory=list)

    def try_everything(self, settings: Settings, *, whole: bool) -> None:
        """Check all rules; those of the bucket only if no setting is wrong."""
        trains = self._is_training(settings)
        bucket = self._bucket(settings, trains=trains) if whole else None
        if not whole:
            self._skip(BUCKET_RULES, "The bucket is checked once the settings are correct.")
        files = self._files(settings, bucket)
        staged = review_stages(settings, files, bucket, resumes=trains)
        self.found += staged.problems
        if staged.stages:
            settings, files = staged.stages[0].settings, dict(staged.stages[0].files)
        examined = self._examined(settings, files, bucket, trains=trains)
        for stage in staged.stages[1:]:
            self._examined(stage.settings, stage.files, None, trains=trains)
        self.found += review_names(settings, console=self.console)
        if examined.source is not None:
            self.found += review_style(examined.source, console=self.console)
        parameters, metadata = examined.review.parameters, examined.review.metadata
        if metadata is not None:
            where = files[keys.MODEL_METADATA_FILE].origin
            self.found += review_actions(
                metadata, parameters, settings, where, console=self.console
            )
        if self.console:
            self.found = [
                replace(each, severity="error") if each.rule == "V-32" else each
                for each in self.found
            ]
        if parameters is not None:
            origin = files[keys.HYPERPARAMETERS_FILE].origin
            self.found += review_balance(settings, parameters, origin)
        self.found += review_memory(
            workers_here(settings), settings.place("DR_WORKERS"), parameters, metadata
        )

    def try_files_alone(self) -> None:
        """Check the three files without the settings, which name the bucket and the track."""
        files = {}
        for name in FILE_RULES:
            try:
                if (file := local_file(self.directory / "custom_files", name)) is not None:
                    files[name] = file
            except ProblemsError as error:
                self.found += error.problems
        reward = files.get(keys.REWARD_FUNCTION_FILE)
        if reward is not None:
            source, wrong = read_source(reward)
            self.found += wrong if source is None else review_source(source)
        self.found += review_parameters(
            files.get(keys.HYPERPARAMETERS_FILE), files.get(keys.MODEL_METADATA_FILE), None
        ).problems
        reason = "Track and bucket are known once the settings are correct."
        self._skip(("V-05", "V-20", "V-21", *BUCKET_RULES), reason)

    def _is_training(self, settings: Settings) -> bool:
        """Whether this run is being trained; if so, warn."""
        record = RunRecord.read(run_folder(self.directory, settings.run_id))
        if record is None or not record.alive:
            return False
        what = (
            f"Run {settings.run_id} is training s3://{record.bucket}/{record.prefix} "
            f"(process {record.pid})."
        )
        remedy = "Stop it with `dr-stop-training` before the next start, or change DR_RUN_ID."
        self.found.append(
            Problem("V-13", "warning", *settings.place("DR_RUN_ID"), what, remedy, "DR_RUN_ID")
        )
        return True

    def _bucket(self, settings: Settings, *, trains: bool) -> Bucket | None:
        """The bucket, if it can be used."""
        try:
            bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
            bucket.probe(keys.run_folder(settings.model_prefix))
            wrong = probe(bucket, settings.model_prefix)
            if not trains:
                wrong += review_owner(settings.model_prefix, bucket)
        except StorageError as error:
            wrong = [_unusable(error, *settings.place("DR_CLOUD"))]
        self.found += wrong
        if any(each.severity == "error" for each in wrong):
            self._skip(BUCKET_RULES[:-1], "The bucket cannot be used.")
            return None
        return bucket

    def _files(self, settings: Settings, bucket: Bucket | None) -> dict[str, InputFile]:
        files: dict[str, InputFile] = {}
        try:
            files = find(settings.custom_files, bucket)
        except ProblemsError as error:
            self.found += error.problems
        except StorageError as error:
            self.found.append(_unusable(error))
        unseen = [name for name in FILE_RULES if name not in files]
        if unseen and bucket is None:
            reason = f"{', '.join(unseen)} may be in the bucket, which cannot be read."
            self._skip(tuple(FILE_RULES[name] for name in unseen), reason)
        return files

    def _examined(
        self,
        settings: Settings,
        files: Mapping[str, InputFile],
        bucket: Bucket | None,
        *,
        trains: bool,
    ) -> Examined:
        """Check the rules of a start, in a folder that no training uses."""
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
            plans = Plans(wiping=trains)  # the prefix of a running training may be in use
            try:
                examined = examine(settings, job, files, bucket, plans)
            except StorageError as error:
                self.found.append(_unusable(error))
                self._skip(BUCKET_RULES[:-1], "The bucket failed in the meantime.")
                examined = examine(settings, job, files, None, plans)
        tracks = track_problems(settings.races)
        to_fetch = {each.where: each for each in tracks if each.severity == "note"}
        for each in examined.problems:
            if each.rule == "V-09":  # a start refuses; here it is only a note
                message = each.message.removesuffix(" Exiting.")
                each = replace(each, severity="note", message=message)
            elif each.rule == "V-05":  # a start offers to fetch the track
                each = to_fetch.get(each.where, each)
            self.found.append(each)
        return examined

    def _skip(self, rules: tuple[str, ...], reason: str) -> None:
        self.skipped.append(Skipped(rules, reason))


def _unusable(error: StorageError, file: str = "", line: int | None = None) -> Problem:
    return Problem("V-50", "error", file, line, str(error), error.remedy)


def _relative(item: Problem, directory: Path) -> Problem:
    """The same problem, with paths relative to the folder."""
    start = f"{directory}{os.sep}"
    file, message, remedy = (
        text.replace(start, "") for text in (item.file, item.message, item.remedy)
    )
    return replace(item, file=file, message=message, remedy=remedy)
