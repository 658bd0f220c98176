"""What keeps a training alive, or ends it in time."""

from drcli.base.elapsed import AwakeClock
from drcli.exchange.job import Job
from drcli.runs.disk_watch import DiskWatch
from drcli.runs.duty import Duty
from drcli.runs.failure_watch import FailureWatch
from drcli.runs.frozen_watch import FrozenWatch
from drcli.runs.memory_watch import MemoryWatch
from drcli.runs.open_files_watch import OpenFilesWatch
from drcli.runs.seen_pulses import SeenPulses
from drcli.runs.stall_watch import StallWatch
from drcli.runs.warnings_board import WarningsBoard


def watches(job: Job, board: WarningsBoard) -> list[Duty]:
    """The first looks at the pulses for the next ones."""
    pulses = SeenPulses(job.folder)
    settings = job.config.unattended
    return [
        FrozenWatch(pulses, board),
        StallWatch(settings.stall_minutes, pulses, board),
        OpenFilesWatch(pulses, board),
        MemoryWatch(board, AwakeClock()),
        DiskWatch(job, board),
        FailureWatch(job, board),
    ]
