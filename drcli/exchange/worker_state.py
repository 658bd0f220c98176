"""What the workers of a training say about themselves: what they do, and that it is over."""

from dataclasses import dataclass

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class ActivityRecord(JsonRecord):
    """What one worker is doing, for people.

    Attributes:
        activity: A few words.
        since: Unix seconds.
        pid: Its process.
        host: Its machine.
    """

    activity: str
    since: float
    pid: int
    host: str


@dataclass(frozen=True)
class TrainingEnd(JsonRecord):
    """The trainer's word that the training is over.

    Attributes:
        session: The start of the training that has ended.
        reason: One sentence.
    """

    session: str
    reason: str
