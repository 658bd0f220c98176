"""The name of a checkpoint and its JSON record, which describe it without its weights."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import JsonRecord, RecordError
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.phase import PhaseMark
from drcli.exchange.stage import StageMark

CHECKPOINT_NAME = re.compile(r"(\d+)_Step-(\d+)\.ckpt")


@dataclass(frozen=True, order=True)
class CheckpointName:
    """Number of a checkpoint, from 0, and the environment steps that it has learned from."""

    number: int
    steps: int

    @classmethod
    def parse(cls, name: str) -> "CheckpointName | None":
        """Read a name such as `12_Step-7824.ckpt`; None if the text is not one."""
        found = CHECKPOINT_NAME.fullmatch(name.strip())
        return cls(int(found[1]), int(found[2])) if found else None

    def __str__(self) -> str:
        return f"{self.number}_Step-{self.steps}.ckpt"


def checkpoint_name(name: str) -> CheckpointName:
    """Read a name such as `12_Step-7824.ckpt`; RecordError if the text is not one."""
    parsed = CheckpointName.parse(name)
    if parsed is None:
        raise RecordError(f"{json.dumps(name)[:60]} is not the name of a checkpoint")
    return parsed


@dataclass(frozen=True)
class Counters:
    """What a trainer continues with, besides the weights.

    Attributes:
        episodes: Training episodes learned from.
        elapsed_s: Wall time of training, without the time it was stopped.
        number_format: Of the weights while they are trained, such as `fp32`.
        learned: The iteration that made the weights; None for the first ones.
        seed: Of the run.
        inputs: The parameter files by name, to restore them if they are lost.
        files: `Job.files_sha256` of the start that trained it; None in version 0.1.0.
        critic_warmup: How many updates at most still improve the critic alone; None but for a
            policy that came without its critic.
        rollbacks: How often the training had gone back to an older checkpoint; None for never.
        stage: The stage of the training that the weights are for; None without a curriculum.
        phase: The phase of a training with a teacher that drives with the weights; else None.
        shares: Version of the `Shares` that say who drives; None where each of DR_WORKERS drives
            the same share.
    """

    episodes: int = 0
    elapsed_s: float = 0.0
    number_format: str | None = None
    learned: IterationRecord | None = None
    seed: int | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    files: str | None = None
    critic_warmup: int | None = None
    rollbacks: int | None = None
    stage: StageMark | None = None
    phase: PhaseMark | None = None
    shares: int | None = None


@dataclass(frozen=True)
class CheckpointRecord(JsonRecord):
    """The record of a checkpoint; `optimizer` is None if it has no optimizer state.

    `sim_time_s` counts the simulated seconds driven since the training began.
    """

    name: str
    tensors: Fingerprint
    optimizer: Fingerprint | None = None
    sim_time_s: float = 0.0
    counters: Counters = field(default_factory=Counters)

    def __post_init__(self) -> None:
        checkpoint_name(self.name)

    @classmethod
    def decode_of(cls, name: str, data: bytes) -> "CheckpointRecord":
        """Read the record of this checkpoint; RecordError if it describes another one."""
        record = cls.decode(data)
        if record.name != name:
            raise RecordError(f"it describes {record.name}")
        return record

    @property
    def number(self) -> int:
        """Counts the checkpoints of a model, from 0."""
        return checkpoint_name(self.name).number

    @property
    def steps(self) -> int:
        """Environment steps that it has learned from."""
        return checkpoint_name(self.name).steps

    def to_json(self) -> dict[str, Any]:
        """The record as JSON, without unknown counters, and with null for NaN."""
        fields = super().to_json()
        counters = {name: value for name, value in fields["counters"].items() if value is not None}
        if "learned" in counters:
            learned = counters["learned"].items()
            counters["learned"] = {
                name: None if _is_nan(value) else value for name, value in learned
            }
        return {**fields, "counters": counters}


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def decode_pointer(data: bytes) -> CheckpointName:
    """The checkpoint that `.coach_checkpoint` names in plain text; RecordError if it is damaged."""
    return checkpoint_name(data.decode(errors="replace"))
