"""Trainings that nobody watches."""

from typing import Literal

from drcli.config.fields import Group, setting
from drcli.config.unattended_types import (
    Command,
    MailAddresses,
    MessageEvents,
    Price,
    Retention,
    SmtpUrl,
    TopicArn,
)
from drcli.config.value_types import Address


class InterruptionSettings(Group, title="Interruptions"):
    continue_on_spot_interruption: bool = setting(
        "DR_CONTINUE_ON_SPOT_INTERRUPTION",
        True,
        "Whether the next machine continues a training whose machine was taken away.",
    )
    time_to_live_minutes: float = setting(
        "DR_TIME_TO_LIVE_MINUTES",
        0.0,
        "Complete the training so many minutes after its first start, pauses included; 0 never.",
        between=(0.0, 10_000_000.0),
    )
    interruption_watch: Literal["auto", "aws", "gcp", "azure", "off"] = setting(
        "DR_INTERRUPTION_WATCH",
        "auto",
        "Whose notices to watch for: those of the cloud that this machine belongs to, or this one.",
        file="system.env",
    )
    interruption_command: Command = setting(
        "DR_INTERRUPTION_COMMAND",
        "",
        "Program that ends with exit code 0 when this machine is about to be taken away.",
        file="system.env",
    )
    metadata_service_url: str = setting(
        "DR_METADATA_SERVICE_URL",
        "",
        "Another address of the cloud's metadata service.",
        file="system.env",
    )
    on_rebalance: Literal["continue", "stop"] = setting(
        "DR_ON_REBALANCE",
        "continue",
        "What a mere recommendation to move to another machine does.",
        file="system.env",
    )
    sigterm_grace_seconds: float = setting(
        "DR_SIGTERM_GRACE_SECONDS",
        30.0,
        "How long a training may take to end after SIGTERM, before it would be killed.",
        between=(5.0, 3600.0),
        file="system.env",
    )


class TimedWorkSettings(Group, title="Uploads during and after a training"):
    regular_upload: int = setting(
        "DR_REGULAR_UPLOAD", 0, "Minutes between uploads of the model; 0 never.", low=0
    )
    regular_physical_model_upload: int = setting(
        "DR_REGULAR_PHYSICAL_MODEL_UPLOAD",
        0,
        "Minutes between archives for the car; 0 never.",
        low=0,
    )
    upload_best_model: bool = setting(
        "DR_UPLOAD_BEST_MODEL", False, "Upload the model whenever it has a new best checkpoint."
    )
    upload_model_on_completion: bool = setting(
        "DR_UPLOAD_MODEL_ON_COMPLETION",
        False,
        "Upload the best checkpoint when the training is complete.",
    )
    import_model_on_completion: bool = setting(
        "DR_IMPORT_MODEL_ON_COMPLETION",
        True,
        "Import the best checkpoint into DeepRacer on AWS when the training is complete; needs "
        "DR_DROA_URL.",
    )
    upload_keep: Retention = setting(
        "DR_UPLOAD_KEEP",
        "",
        "Checkpoints and car archives to keep where they are uploaded to, such as "
        "last-3,best,every-50; empty for all.",
    )
    upload_max_mb: int = setting(
        "DR_UPLOAD_MAX_MB",
        0,
        "Largest size of the checkpoints there, and of the car archives, in MB; 0 for no limit.",
        low=0,
    )
    on_end: str = setting(
        "DR_ON_END", "", "Command for the shell that runs when a training has ended, however."
    )


class CostSettings(Group, title="Money"):
    spot_price: Price = setting(
        "DR_SPOT_PRICE",
        "",
        "What this machine costs in USD per hour; auto asks EC2; empty if it does not matter.",
        file="system.env",
    )
    max_cost: float = setting(
        "DR_MAX_COST",
        0.0,
        "End the training when all its machines together have cost so many USD; 0 for no limit.",
        low=0,
    )
    daily_budget_hours: float = setting(
        "DR_DAILY_BUDGET_HOURS",
        0.0,
        "Machine hours that all trainings of this folder together may take on one day; 0 for no "
        "limit.",
        between=(0.0, 1_000_000.0),
        file="system.env",
    )
    daily_budget_money: float = setting(
        "DR_DAILY_BUDGET_MONEY",
        0.0,
        "USD that all trainings of this folder together may cost on one day, at DR_SPOT_PRICE; 0 "
        "for no limit.",
        between=(0.0, 1_000_000.0),
        file="system.env",
    )


class WatchSettings(Group, title="Watches", file="system.env"):
    stall_minutes: int = setting(
        "DR_STALL_MINUTES",
        10,
        "Minutes without any progress after which workers are restarted, and the training ends if "
        "that does not help; 0 never.",
        low=0,
    )
    disk_min_mb: int = setting(
        "DR_DISK_MIN_MB",
        500,
        "Free megabytes on the disk of data/ below which the training stops in time to save "
        "everything; 0 never.",
        low=0,
    )


class MessageSettings(Group, title="Messages", file="system.env"):
    sns_topic_arn: TopicArn = setting(
        "DR_SNS_TOPIC_ARN", "", "Topic of Amazon SNS for messages; if empty, MY_SNS_TOPIC."
    )
    webhook_url: Address = setting(
        "DR_WEBHOOK_URL", "", "Address for messages in Slack, Discord, Mattermost or your program."
    )
    mail_to: MailAddresses = setting("DR_MAIL_TO", "", "Mail addresses for messages.")
    mail_from: MailAddresses = setting(
        "DR_MAIL_FROM", "", "Sender of these mails; if empty, the first of DR_MAIL_TO."
    )
    smtp_url: SmtpUrl = setting(
        "DR_SMTP_URL",
        "",
        "Mail server, as in smtps://user:password@mail.example.com:465.",
    )
    message_events: MessageEvents = setting(
        "DR_MESSAGE_EVENTS",
        "start,resume,interruption,end,failure,stall",
        "What to tell: start, resume, interruption, end, failure, stall, stop, fault, recovery, "
        "stage, best, upload; or all.",
    )
