"""Account, bucket and checked settings of a training on machines of Amazon."""

import os
from collections.abc import Mapping
from pathlib import Path

from drcli.base.errors import Problem, ProblemsError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.bucket.endpoint import read_profile
from drcli.config import loading
from drcli.config.settings import Settings
from drcli.config.value_types import HOME_REGION
from drcli.outside.aws.aws_account import PROFILE_SETTING, Account
from drcli.outside.aws.racer_files import environment

with lazy_imports():
    from drcli.checks import validate
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
        remedy="Make one with `dr-spot create-base NAME` and add --base NAME, or add --bucket.",
    )


def checked_settings(
    folder: Path, account: Account, bucket: str, stack: str, before: Settings
) -> tuple[Settings, list[Problem]]:
    """The settings as the machine will have them, and warnings.

    Raises:
        ProblemsError: Settings, files or reward function are wrong.
    """
    creation.check_bucket(account, bucket)
    variables = environment(bucket, account.region, stack, before.upload_s3_bucket)
    variables["DR_LOCAL_S3_PROFILE"] = account.profile or "default"
    report = validate.validate(folder, environ={**os.environ, **variables}, here=False)
    if not report.ok:
        raise ProblemsError(list(report.errors))
    warnings = [each for each in report.warnings if each.rule != "V-50"]  # of this machine
    return _loaded(folder, variables), warnings


def _loaded(folder: Path, variables: Mapping[str, str]) -> Settings:
    return loading.load_settings(folder, environ={**os.environ, **variables})
