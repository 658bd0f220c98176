"""How a training was started: `ip/run.json`."""

from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class GitState:
    commit: str
    dirty: bool


@dataclass(frozen=True)
class Pretrained:
    """Weights to start from.

    Attributes:
        prefix: Their model.
        checkpoint: Which one: last, best, the word of a milestone, or a number.
        name: That checkpoint, such as `12_Step-7824.ckpt`.
        metric: Mean score of its evaluation; None without one.
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
        settings: DR_ settings that differ from their defaults.
        cars: DR_SIM_CAR of the first worker, and of others with their own race.
        versions: None if not installed.
        git: Of the `working_folder` and our own `package`; None outside git.
        machine: `platform`, `processor`, `cores`, `threads` if OMP_NUM_THREADS is set.
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
        fields = super().to_json()
        for start in fields["earlier"]:
            del start["earlier"]
        return fields
