"""Checks whether the values of settings fit each other."""

from collections.abc import Iterator

from drcli.base.problems import Problem, Severity
from drcli.config.figure_types import LOOPBACK_HOSTS
from drcli.config.setting_problems import setting_problem
from drcli.config.settings import Settings
from drcli.config.value_types import BUCKET_RULE, RUN_FOLDERS, follows_s3


def contradictions(settings: Settings) -> Iterator[Problem]:
    """Values that do not fit together, and one that the reference refuses."""

    def problem(
        names: tuple[str, ...], message: str, remedy: str, severity: Severity = "error"
    ) -> Problem:
        name = next((name for name in names if name in settings.sources), names[-1])
        return setting_problem(name, settings.place(name), message, remedy, severity=severity)

    if settings.eval_max_resets == 1:
        yield problem(
            ("DR_EVAL_MAX_RESETS",),
            "DR_EVAL_MAX_RESETS=1 puts a car back once here; the reference refuses 1.",
            "Write 0, or 2 or more, for a training on the reference.",
            severity="warning",
        )
    if settings.cloud in ("remote", "azure") and not settings.remote_minio_url:
        yield problem(
            ("DR_CLOUD",),
            f"DR_CLOUD={settings.cloud} needs an address, but DR_REMOTE_MINIO_URL is empty.",
            "Set DR_REMOTE_MINIO_URL, as in http://192.168.1.5:9000, or write DR_CLOUD=local.",
        )
    if settings.cloud in ("local", "aws") and not follows_s3(settings.bucket):
        yield problem(
            ("DR_LOCAL_S3_BUCKET",),
            f"DR_LOCAL_S3_BUCKET={settings.bucket} is not the name of a bucket with "
            f"DR_CLOUD={settings.cloud}.",
            BUCKET_RULE,
        )
    if settings.webviewer_auth == "none" and settings.webviewer_host not in LOOPBACK_HOSTS:
        yield problem(
            ("DR_WEBVIEWER_AUTH",),
            f"DR_WEBVIEWER_AUTH=none would let every machine that reaches "
            f"{settings.webviewer_host} (DR_WEBVIEWER_HOST) run code here.",
            "Remove one of the two.",
        )
    if settings.train_overlap == "off" and settings.train_max_lag > 1:
        yield problem(
            ("DR_TRAIN_MAX_LAG",),
            f"DR_TRAIN_MAX_LAG={settings.train_max_lag} lets workers drive while the trainer "
            "learns, but DR_TRAIN_OVERLAP=off forbids that.",
            "Remove DR_TRAIN_MAX_LAG, or set DR_TRAIN_OVERLAP to auto.",
        )
    if settings.h2b_lower_lane_change_time > settings.h2b_upper_lane_change_time:
        yield problem(
            ("DR_H2B_LOWER_LANE_CHANGE_TIME", "DR_H2B_UPPER_LANE_CHANGE_TIME"),
            f"DR_H2B_LOWER_LANE_CHANGE_TIME={settings.h2b_lower_lane_change_time} is more than "
            f"DR_H2B_UPPER_LANE_CHANGE_TIME={settings.h2b_upper_lane_change_time}.",
            "Swap the two, or set both to the same time.",
        )
    if f"{settings.custom_files_prefix}/".startswith(f"{settings.model_prefix}/"):
        yield problem(
            ("DR_LOCAL_S3_MODEL_PREFIX", "DR_LOCAL_S3_CUSTOM_FILES_PREFIX"),
            f"DR_LOCAL_S3_MODEL_PREFIX={settings.model_prefix} is the folder of your own files, or "
            f"contains it (DR_LOCAL_S3_CUSTOM_FILES_PREFIX={settings.custom_files_prefix}).",
            "Give the model a separate folder; otherwise -w would delete your files.",
        )
    for name, prefix in _models_named(settings):
        if prefix.startswith(f"{settings.custom_files_prefix}/"):
            yield problem(
                (name, "DR_LOCAL_S3_CUSTOM_FILES_PREFIX"),
                f"{name}={prefix} is inside the folder of your own files "
                f"(DR_LOCAL_S3_CUSTOM_FILES_PREFIX={settings.custom_files_prefix}).",
                "Give the model a folder outside it; otherwise they could overwrite each other.",
            )
    first, slash, _ = settings.model_prefix.partition("/")
    if slash and first in RUN_FOLDERS:
        yield problem(
            ("DR_LOCAL_S3_MODEL_PREFIX",),
            f"DR_LOCAL_S3_MODEL_PREFIX={settings.model_prefix} is inside {first}/, where "
            "trainings and races keep files of their own.",
            f"Choose a prefix that starts with another name, such as my-{first}/.",
        )
    if settings.max_cost > 0.0 and not settings.spot_price:
        yield problem(
            ("DR_MAX_COST",),
            f"DR_MAX_COST={settings.max_cost:g} cannot be kept: the price of this machine is not "
            "known.",
            "Set DR_SPOT_PRICE in system.env: USD per hour, or auto on EC2.",
        )
    if settings.daily_budget_money > 0.0 and not settings.spot_price:
        yield problem(
            ("DR_DAILY_BUDGET_MONEY",),
            f"DR_DAILY_BUDGET_MONEY={settings.daily_budget_money:g} cannot be kept: the price of "
            "this machine is not known.",
            "Set DR_SPOT_PRICE in system.env: USD per hour, or auto on EC2.",
        )
    if settings.train_best_model_world != "training" and not settings.train_eval_world:
        yield problem(
            ("DR_TRAIN_BEST_MODEL_WORLD",),
            f"DR_TRAIN_BEST_MODEL_WORLD={settings.train_best_model_world} needs a second track, "
            "but DR_TRAIN_EVAL_WORLD is empty.",
            "Set DR_TRAIN_EVAL_WORLD to a track, or DR_TRAIN_BEST_MODEL_WORLD to training.",
        )
    if settings.mail_to and not settings.smtp_url:
        yield problem(
            ("DR_MAIL_TO",),
            "DR_MAIL_TO is set, but DR_SMTP_URL is empty, so no mail can be sent.",
            "Set DR_SMTP_URL in system.env, as in smtps://user:password@mail.example.com:465.",
        )
    if settings.pretrained and settings.pretrained_prefix == settings.model_prefix:
        yield problem(
            ("DR_LOCAL_S3_PRETRAINED_PREFIX",),
            f"DR_LOCAL_S3_PRETRAINED_PREFIX={settings.pretrained_prefix} is the model to train.",
            f"Give DR_LOCAL_S3_MODEL_PREFIX a new name, such as {settings.model_prefix}-clone.",
        )


def _models_named(settings: Settings) -> Iterator[tuple[str, str]]:
    yield "DR_LOCAL_S3_MODEL_PREFIX", settings.model_prefix
    if settings.pretrained:
        yield "DR_LOCAL_S3_PRETRAINED_PREFIX", settings.pretrained_prefix
    if settings.upload_s3_bucket == settings.bucket:
        yield "DR_UPLOAD_S3_PREFIX", settings.upload_s3_prefix
