"""Checks all rules on a working folder, for `dr validate`."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.base.errors import Problem, ProblemsError, StorageError, grouped, of_severity
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.checks.before_start import Examined, Plans, examine_stages
from drcli.checks.check_report import Report, Skipped
from drcli.checks.compatibility_rules import (
    destinations,
    review_actions,
    review_balance,
    review_names,
)
from drcli.checks.destination_rules import DESTINATIONS, review_destination
from drcli.checks.machine_rules import review_gpu, review_memory
from drcli.checks.parameter_rules import review_parameters
from drcli.checks.settings_rules import SettingsReview, review_settings
from drcli.checks.stage_rules import StagesReview, review_stages
from drcli.checks.start_rules import probe, review_minio_folder, review_owner, start_problems
from drcli.config.adoption import winning_functions
from drcli.config.settings import Settings
from drcli.config.track_names import track_problems
from drcli.model import keys
from drcli.model.files.custom_files import FILE_RULES, InputFile, find, local_file
from drcli.model.model_prefix import ModelListing
from drcli.model.model_store import ModelStore
from drcli.records.run_record import RunRecord, run_folder
from drcli.rewards.reward_rules import is_undefined_name, read_source, review_source
from drcli.rewards.reward_style import review_style
from drcli.rewards.try_inputs import as_given, races_of
from drcli.workers.ray_extra import workers_here

BUCKET_RULES = ("V-09", "V-10", "V-13", "V-15", "V-35", "V-50")


def validate(
    directory: Path,
    *,
    console_compatible: bool = False,
    environ: Mapping[str, str] | None = None,
    reviewed: SettingsReview | None = None,
    here: bool = True,
    destination: str = "",
) -> Report:
    """Check all rules; nothing in the folder changes.

    `console_compatible` makes what a console refuses an error. `here`: room and runs of this
    machine count. `destination`: a key of `DESTINATIONS`, which the trained model must suit.
    """
    directory = directory.absolute()
    environ = os.environ if environ is None else environ
    reviewed = reviewed or review_settings(directory, environ)
    validation = _Validation(
        directory, console_compatible, environ, here, destination, list(reviewed.problems)
    )
    if reviewed.settings is None:
        validation.try_files_alone()
    else:
        validation.try_everything(reviewed.settings, whole=reviewed.whole)
    if here:
        validation.found += winning_functions(directory, environ)
    found = [_relative(each, directory) for each in validation.found]
    warnings = of_severity(found, "warning")
    return Report(
        str(directory),
        console_compatible,
        of_severity(found, "error"),
        warnings if console_compatible else tuple(grouped(warnings)),
        tuple(validation.skipped),
        of_severity(found, "note"),
        validation.goes_to,
        destination,
    )


@dataclass
class _Validation:
    directory: Path
    console: bool
    environ: Mapping[str, str]
    here: bool
    destination: str
    found: list[Problem]
    skipped: list[Skipped] = field(default_factory=list)
    goes_to: str = ""

    def try_everything(self, settings: Settings, *, whole: bool) -> None:
        trains = self._is_training(settings)
        self.found += start_problems(settings, here=self.here)
        bucket = self._bucket(settings, trains=trains) if whole else None
        if not whole:
            self._skip(BUCKET_RULES, "The bucket is checked once the settings are correct.")
        files = self._files(settings, bucket)
        staged = review_stages(settings, files, bucket, resumes=trains)
        self.found += staged.problems
        if staged.stages:
            settings = staged.stages[0].settings
        examined = self._examined(settings, staged, files, bucket, trains=trains)
        self.found += review_names(settings, console=self.console)
        if examined.source is not None:
            self.found += review_style(examined.source, console=self.console)
        parameters, metadata = examined.review.parameters, examined.review.metadata
        if metadata is not None:
            where = examined.files[keys.MODEL_METADATA_FILE].origin
            self.goes_to = "" if self.destination else destinations(metadata)
            self.found += review_actions(
                metadata, parameters, settings, where, console=self.console
            )
        if self.console:
            self.found = [
                replace(each, severity="error")
                if each.rule in ("V-32", "V-41") or is_undefined_name(each)
                else each
                for each in self.found
            ]
        if parameters is not None:
            origin = examined.files[keys.HYPERPARAMETERS_FILE].origin
            self.found += review_balance(settings, parameters, origin, console=self.console)
        if self.destination:
            self._examine_destination(settings, examined)
        if self.here:
            self.found += review_memory(
                workers_here(settings), settings.place("DR_WORKERS"), parameters, metadata
            )
            self.found += review_gpu(settings.sagemaker_cuda_devices, self.environ)

    def _examine_destination(self, settings: Settings, examined: Examined) -> None:
        design, place = examined.review.design, DESTINATIONS[self.destination]
        if design is None or keys.REWARD_FUNCTION_FILE not in examined.files:
            self._skip(("V-16",), f"What {place} takes is checked once the files are correct.")
            return
        found = [*review_destination(self.destination, settings, examined.files, design)]
        self.found += found
        if not of_severity(found, "error"):
            self.goes_to = f"The trained model can go to {place}."

    def try_files_alone(self) -> None:
        """Without settings, which name the bucket and the track."""
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
        record = RunRecord.read(run_folder(self.directory, settings.run_id))
        return self.here and record is not None and record.alive

    def _bucket(self, settings: Settings, *, trains: bool) -> Bucket | None:
        try:
            bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
            model = ModelStore(bucket, settings.model_prefix)
            self.found += probe(model)
            if not trains:
                self.found += review_owner(model)
            self.found += review_minio_folder(settings, bucket)
        except StorageError as error:
            self.found.append(_unusable(error, *settings.place("DR_CLOUD")))
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
        staged: StagesReview,
        files: Mapping[str, InputFile],
        bucket: Bucket | None,
        *,
        trains: bool,
    ) -> Examined:
        plans = Plans(wiping=trains)  # the prefix of a running training may be in use
        try:
            if bucket is not None and not trains:
                model = ModelStore(bucket, settings.model_prefix)
                plans = Plans(listed=ModelListing(model))
            examined = examine_stages(settings, staged, files, bucket, plans)
        except StorageError as error:
            self.found.append(_unusable(error))
            self._skip(BUCKET_RULES[:-1], "The bucket failed in the meantime.")
            examined = examine_stages(settings, staged, files, None, plans)
        configs = [settings.run, *(stage.settings.run for stage in staged.stages)]
        races = [race for config in configs for race in races_of(config)]
        to_fetch = {each.where: each for each in track_problems(races) if each.severity == "note"}
        for each in examined.problems:
            if each.rule == "V-09":  # the options of a start say what happens to it
                message = each.message.removesuffix(" Exiting.")
                each = replace(each, severity="note", message=message)
            elif each.rule == "V-05" and each.where in to_fetch:
                each = as_given(to_fetch[each.where], settings.run)
            self.found.append(each)
        return examined

    def _skip(self, rules: tuple[str, ...], reason: str) -> None:
        self.skipped.append(Skipped(rules, reason))


def _unusable(error: StorageError, file: str = "", line: int | None = None) -> Problem:
    return Problem("V-50", "error", file, line, str(error), error.remedy)


def _relative(item: Problem, directory: Path) -> Problem:
    start = f"{directory}{os.sep}"
    file, message, remedy = (
        text.replace(start, "") for text in (item.file, item.message, item.remedy)
    )
    return replace(item, file=file, message=message, remedy=remedy)
