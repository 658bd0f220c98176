"""What the newest start of a run came to: the next start reads it, on whichever machine."""

from dataclasses import dataclass

from drcli.base.json_record import JsonRecord
from drcli.exchange.run_record import State


@dataclass(frozen=True)
class RunOutcome(JsonRecord):
    """The newest start of a run. It is written when the start begins, and again at its end.

    A start whose machine vanished leaves the record of its beginning, in state "running".

    Attributes:
        session: Unique name of the start.
        host: Name of its machine, for people.
        began_at: Unix seconds of the very first start of the run.
        started_at: Unix seconds of this start.
        state: "running" until the start has ended.
        goals: A sentence with everything that ends the training. A finished run with other goals
            than these may go on.
        code: Exit code.
        message: Why it ended.
        remedy: What to do then.
        ended_at: Unix seconds of the end.
        stays_ended: Whether only an explicit `--resume` continues it: a person stopped it, or the
            settings say so.
        left: Work at the end of a finished training that is still to be done, by name.
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
        """Whether the start has recorded its end."""
        return self.state != "running"
