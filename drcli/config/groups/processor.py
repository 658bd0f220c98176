"""How much of this machine's processor a run may take."""

from typing import Literal

from drcli.config.fields import Group, setting


class ProcessorSettings(Group, title="Processor", file="system.env"):
    priority: Literal["normal", "low"] = setting(
        "DR_PRIORITY",
        "normal",
        "low: trainings and evaluations leave processor and disk to other programs that want them.",
    )
    threads: int = setting(
        "DR_THREADS",
        0,
        "Most processor cores that a training or an evaluation uses; 0 for all.",
        between=(0, 1024),
    )
