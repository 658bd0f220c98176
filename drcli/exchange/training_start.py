"""How a training was started: `ip/run.json`, which the next start reads."""

from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class GitState:
    """The commit that is checked out, and whether a tracked file was changed since then."""

    commit: str
    dirty: bool


@dataclass(frozen=True)
class Pretrained:
    """Weights to start from.

    Attributes:
        prefix: Their model.
        checkpoint: Which of its checkpoints: last, best, the word of a milestone, or a number.
        name: That checkpoint, such as `12_Step-7824.ckpt`.
        metric: Mean score of its evaluation there; None if it was not evaluated.
        sha256: Fingerprint of the weights.
    """

    prefix: str
    checkpoint: str
    name: str
    metric: float | None
    sha256: str


@dataclass(frozen=True)
class TrainingStart(JsonRecord):
    """One start of a training. The first versions wrote the seed only.

    Attributes:
        started_at: Time in UTC, ISO 8601.
        settings: DR_ settings that differ from their defaults; None if unknown.
        cars: DR_SIM_CAR of the first worker, and of all others that have a race of their own;
            empty if unknown.
        versions: Python and important packages; None for a package that is not installed.
        git: State of the racer's `working_folder` and of our own `package`; None outside git.
        machine: `platform`, `processor`, number of `cores`, and `threads` if OMP_NUM_THREADS
            limits them.
        pretrained: None if the model began with new weights.
        earlier: The starts that this one resumes, oldest first.
        training: Id of the record of the training; empty before there were records.
    """

    seed: int
    started_at: str = ""
    settings: dict[str, Any] | None = None
    cars: list[str] = field(default_factory=list)
    versions: dict[str, str | None] = field(default_factory=dict)
    git: dict[str, GitState | None] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)
    pretrained: Pretrained | None = None
    earlier: list["TrainingStart"] = field(default_factory=list)
    training: str = ""

    def to_json(self) -> dict[str, Any]:
        """The record as JSON: only the latest start lists the earlier ones."""
        fields = super().to_json()
        for start in fields["earlier"]:
            del start["earlier"]
        return fields
