"""Trainings that nobody watches: interruptions, uploads by the clock, messages, money, faults."""

from drcli.config.fields import Group, setting


class InterruptionSettings(Group, title="Interruptions"):
    """Machines that may be taken away, such as spot instances."""

    continue_on_spot_interruption: bool = setting(
        "DR_CONTINUE_ON_SPOT_INTERRUPTION",
        True,
        "Whether the next machine continues a training whose machine was taken away.",
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
    """Who is told what happens to a training."""
