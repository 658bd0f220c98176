"""Trainings that nobody watches: interruptions, uploads by the clock, messages, money, faults."""

from typing import Literal

from drcli.config.fields import Group, setting


class InterruptionSettings(Group, title="Interruptions"):
    """Machines that may be taken away, such as spot instances."""

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
    interruption_command: str = setting(
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
    """Uploads while a model trains, and at its end."""

    regular_upload: int = setting(
        "DR_REGULAR_UPLOAD", 0, "Minutes between uploads of the model; 0 never.", low=0
    )
    regular_physical_model_upload: int = setting(
        "DR_REGULAR_PHYSICAL_MODEL_UPLOAD",
        0,
        "Minutes between archives for the car; 0 never.",
        low=0,
    )
    import_model_on_completion: bool = setting(
        "DR_IMPORT_MODEL_ON_COMPLETION",
        True,
        "Import the model into DeepRacer on AWS when the training is complete.",
    )


class WatchSettings(Group, title="Watches", file="system.env"):
    """What ends or mends a training that is in trouble."""


class MessageSettings(Group, title="Messages", file="system.env"):
    """Who is told what happens to a training."""
