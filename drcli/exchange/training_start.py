"""How a training was started: `ip/run.json`."""

from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class GitState:
    """`dirty`: tracked files were changed."""

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
        started_at: UTC, ISO 8601.
        settings: DR_ settings that differ from their defaults.
        cars: DR_SIM_CAR of the first worker, and of others with their own race.
        versions: None if not installed.
        git: Of the `working_folder` and our own `package`; None outside git.
        machine: `platform`, `processor`, `cores`, `threads` if OMP_NUM_THREADS is set.
        earlier: Resumed starts, oldest first.
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
        """Only the latest start lists the earlier ones."""
        fields = super().to_json()
        for start in fields["earlier"]:
            del start["earlier"]
        return fields
