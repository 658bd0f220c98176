"""Account, bucket and checked settings of a training on machines of Amazon."""

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.base.clock import Waiting
from drcli.base.errors import Problem, ProblemsError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.bucket.endpoint import read_profile
from drcli.config import loading
from drcli.config.settings import Settings
from drcli.config.value_types import HOME_REGION
from drcli.outside.aws import racer_files
from drcli.outside.aws.aws_account import PROFILE_SETTING, Account
from drcli.outside.aws.racer_files import environment, files_to_send
from drcli.run.track_fetch import missing_tracks

with lazy_imports():
    from drcli.checks import stage_rules, validate
    from drcli.outside.aws import creation

BUCKET_VARIABLE = "BUCKET"
"""As deepracer-on-the-spot."""


def account_of(
    settings: Settings | None, region: str | None = None, profile: str | None = None
) -> Account:
    """The account of this region and profile, else of the settings, else of the AWS files."""
    own = None
    if settings is not None and settings.cloud == "aws":
        own = settings.profile or None
    chosen = profile or own
    if not region and settings is not None and "DR_AWS_APP_REGION" in settings.sources:
        region = settings.aws_app_region
    return Account(region or usual_region(chosen), chosen)


def usual_region(profile: str | None) -> str:
    """The AWS command's region, else Amazon's first."""
    named = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    return named or read_profile(profile, PROFILE_SETTING).region or HOME_REGION


def read_settings(folder: Path, region: str | None = None, profile: str | None = None) -> Settings:
    """Settings before the bucket is known, which files for machines name by a variable."""
    names = ("DEEPRACER_S3_URI", "DR_S3_URI", "MY_BUCKET")
    found = dict.fromkeys(names, os.environ.get(BUCKET_VARIABLE) or "bucket")
    found["DEEPRACER_REGION"] = region or usual_region(profile)
    later = {name: value for name, value in found.items() if name not in os.environ}
    return _loaded(folder, later)


def usual_bucket(settings: Settings) -> str:
    """SettingsError if neither environment nor settings name a bucket at Amazon."""
    if named := os.environ.get(BUCKET_VARIABLE):
        return named
    if settings.cloud == "aws":
        return settings.bucket
    raise SettingsError(
        "No bucket at Amazon is named.",
        remedy="Make one with `dr-spot create-base NAME` and name it with --base, or name one that "
        "you have with --bucket.",
    )


@dataclass(frozen=True)
class Checked:
    """What the machine gets.

    Attributes:
        settings: As it will have them.
        files: By path in its folder.
        variables: Of its environment.
    """

    settings: Settings
    files: dict[str, bytes]
    variables: dict[str, str]
    warnings: list[Problem]


def prepare(
    folder: Path,
    account: Account,
    options: "creation.StackOptions",
    before: Settings,
    install: str,
    shown: Path,
    waiting: Waiting,
) -> "creation.StackPlan":
    """Check a training as its machine will, and estimate its cost; changes nothing.

    Args:
        folder: Of the settings and files.
        account: Where it is to run.
        options: Of the stack.
        before: `read_settings` of the folder.
        install: What the machine installs, as `find_source` takes it.
        shown: What messages call the folder.
        waiting: Called with what is done next.

    Raises:
        ProblemsError: Settings, files or reward function are wrong.
        SettingsError: An option is wrong, or a file cannot be sent.
        StorageError: Amazon does not answer or refuses.
    """
    creation.check_options(options)
    with waiting("Checking settings, files and reward function ..."):
        checked = check_settings(folder, account, options.bucket, options.stack, before, shown)
    with waiting("Preparing what the machine installs ..."):
        source = racer_files.find_source(install)
    with waiting(f"Asking Amazon for quotas and prices in {account.region} ..."):
        plan = creation.prepare(
            account,
            checked.settings,
            options,
            source,
            checked.files,
            checked.variables,
            not_imported(before),
        )
    notes = [*map(str, checked.warnings), *plan.notes]
    if missing := missing_tracks(checked.settings):
        notes.append(f"The machine downloads tracks of the community: {', '.join(missing)}.")
    return replace(plan, notes=tuple(notes))


def check_settings(
    folder: Path, account: Account, bucket: str, stack: str, before: Settings, shown: Path
) -> Checked:
    """Check as the machine will, with nothing but what it gets; messages name the folder `shown`.

    Raises:
        ProblemsError: Settings, files or reward function are wrong.
        SettingsError: A file cannot be sent.
    """
    creation.check_bucket(account, bucket)
    variables = environment(before, bucket, account.region, stack, os.environ)
    profile = {"DR_LOCAL_S3_PROFILE": account.profile or "default"}
    settings = _loaded(folder, variables | profile)
    sent = _sent(settings)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DR_")}
    with tempfile.TemporaryDirectory() as place:
        for name, data in sent.items():
            path = Path(place, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        report = validate.validate(
            Path(place), environ={**kept, **variables, **profile}, here=False
        )
        errors, warnings = (
            [_in_folder(each, place, str(shown)) for each in found]
            for found in (report.errors, report.warnings)
        )
    if errors:
        raise ProblemsError(errors)
    of_training = [each for each in warnings if each.rule != "V-50"]  # that is of this machine
    return Checked(settings, sent, variables, of_training)


def not_imported(settings: Settings) -> str:
    """Why the machine imports no model into DeepRacer on AWS; empty if none is wanted."""
    wanted = settings.import_model_on_completion
    named = settings.droa_url or "DR_IMPORT_MODEL_ON_COMPLETION" in settings.sources
    if not wanted or not named:
        return ""
    if not settings.droa_url:
        return "DR_DROA_URL is empty."
    return "a machine gets no password. `droa-import-model --best` does it from here."


def _sent(settings: Settings) -> dict[str, bytes]:
    stages = stage_rules.review_stages(settings, {}).stages
    named = [Path(file.origin) for stage in stages for file in stage.files.values()]
    if settings.curriculum_file:
        named.append(stage_rules.curriculum_path(settings))
    return files_to_send(
        settings, [race for stage in stages for race in stage.settings.races], named
    )


def _in_folder(problem: Problem, place: str, shown: str) -> Problem:
    file, message, remedy = (
        text.replace(place, shown) for text in (problem.file, problem.message, problem.remedy)
    )
    return replace(problem, file=file, message=message, remedy=remedy)


def _loaded(folder: Path, variables: Mapping[str, str]) -> Settings:
    return loading.load_settings(folder, environ={**os.environ, **variables})
