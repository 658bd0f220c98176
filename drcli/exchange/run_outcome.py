"""What the newest start of a run came to, for the next one."""

from dataclasses import dataclass

from drcli.base.json_record import JsonRecord
from drcli.exchange.run_record import State


@dataclass(frozen=True)
class RunOutcome(JsonRecord):
    """The newest start of a run, written at its begin and end; "running" if its machine vanished.

    Attributes:
        began_at: Of the very first start.
        goals: With others, a finished run may go on.
        stays_ended: Only `--resume` continues it.
        left: Work at the end that is still to do.
    """

    session: str
    host: str
    began_at: float
    started_at: float
    state: State = "running"
    goals: str = ""
    code: int | None = None
    message: str = ""
    remedy: str = ""
    ended_at: float | None = None
    stays_ended: bool = False
    left: tuple[str, ...] = ()

    @property
    def ended(self) -> bool:
        return self.state != "running"
