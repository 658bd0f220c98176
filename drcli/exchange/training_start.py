"""What a training was started with: `ip/run.json`, written by one start and read by the next."""

from dataclasses import dataclass, field
from typing import Any, Literal

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class GitState:
    """Which version of some files git knows.

    Attributes:
        commit: The commit that is checked out.
        dirty: Whether a file that git tracks was changed since.
    """

    commit: str
    dirty: bool


@dataclass(frozen=True)
class Pretrained:
    """Weights to start from.

    Attributes:
        prefix: The model they are from.
        checkpoint: Which of its checkpoints: last or best.
        name: That checkpoint, such as `12_Step-7824.ckpt`.
        metric: How it was evaluated there, None where it was not.
        sha256: Fingerprint of the weights.
    """

    prefix: str
    checkpoint: Literal["last", "best"]
    name: str
    metric: float | None
    sha256: str


@dataclass(frozen=True)
class TrainingStart(JsonRecord):
    """One start of a training. The first versions wrote the seed only.

    Attributes:
        seed: What its random numbers are derived from.
        started_at: Time in UTC, ISO 8601.
        settings: DR_ settings that differ from their defaults; None where unknown.
        versions: Python and the packages that matter; None where one is not installed.
        git: State of the racer's `working_folder` and of our own `package`; None outside git.
        machine: `platform`, `processor`, number of `cores`, and `threads` where OMP_NUM_THREADS
            limits them.
        pretrained: Whose weights the model began with; None where they were fresh.
        earlier: The starts before that this one resumes, oldest first.
    """

    seed: int
    started_at: str = ""
    settings: dict[str, Any] | None = None
    versions: dict[str, str | None] = field(default_factory=dict)
    git: dict[str, GitState | None] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)
    pretrained: Pretrained | None = None
    earlier: list["TrainingStart"] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """The record as JSON: only the latest start lists the earlier ones."""
        fields = super().to_json()
        for start in fields["earlier"]:
            del start["earlier"]
        return fields
