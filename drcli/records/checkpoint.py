"""The name of a checkpoint and its JSON record."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from msgspec import Meta

from drcli.base.json_record import Fingerprint, JsonRecord, RecordError, SafeInt, Seconds, plain
from drcli.records.iteration import IterationRecord
from drcli.records.stage import PhaseMark, RangesMark, StageMark

CHECKPOINT_NAME = re.compile(r"(\d+)_Step-(\d+)\.ckpt")

NameText = Annotated[str, Meta(pattern=rf"^{CHECKPOINT_NAME.pattern}\Z", max_length=60)]


@dataclass(frozen=True, order=True)
class CheckpointName:
    """Number, from 0, and environment steps learned from."""

    number: int
    steps: int

    @classmethod
    def parse(cls, name: str) -> "CheckpointName | None":
        """Such as `12_Step-7824.ckpt`; None if it is not one."""
        found = CHECKPOINT_NAME.fullmatch(name.strip())
        return cls(int(found[1]), int(found[2])) if found else None

    def __str__(self) -> str:
        return f"{self.number}_Step-{self.steps}.ckpt"


def checkpoint_name(name: str) -> CheckpointName:
    parsed = CheckpointName.parse(name)
    if parsed is None:
        raise RecordError(f"{json.dumps(name)[:60]} is not the name of a checkpoint")
    return parsed


@dataclass(frozen=True)
class Counters:
    """What a trainer continues with, besides the weights.

    Attributes:
        elapsed_s: Wall time of training, without stops.
        number_format: While training, such as `fp32`.
        inputs: Parameter files by name, to restore lost ones.
        files: `Job.files_sha256` of its start.
        critic_warmup: Updates that may still improve only the critic.
        shares: Version of the `Shares`; None where DR_WORKERS share evenly.
        ranges: None without DR_SIM_GROW.
    """

    episodes: SafeInt = 0
    elapsed_s: Seconds = 0.0
    number_format: str | None = None
    learned: IterationRecord | None = None
    seed: SafeInt | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    files: str | None = None
    critic_warmup: SafeInt | None = None
    rollbacks: SafeInt | None = None
    stage: StageMark | None = None
    phase: PhaseMark | None = None
    shares: SafeInt | None = None
    ranges: RangesMark | None = None


@dataclass(frozen=True)
class CheckpointRecord(JsonRecord):
    """`sim_time_s` counts simulated seconds of all cars since the training began."""

    name: NameText
    tensors: Fingerprint
    optimizer: Fingerprint | None = None
    sim_time_s: Seconds = 0.0
    counters: Counters = field(default_factory=Counters)

    @classmethod
    def decode_of(cls, name: str, data: bytes) -> "CheckpointRecord":
        """RecordError if damaged, or another checkpoint's."""
        record = cls.decode(data)
        if record.name != name:
            raise RecordError(f"it describes {record.name}")
        return record

    @property
    def number(self) -> int:
        return checkpoint_name(self.name).number

    @property
    def steps(self) -> int:
        return checkpoint_name(self.name).steps

    def to_json(self) -> dict[str, Any]:
        fields = plain(super().to_json())
        counters = {name: value for name, value in fields["counters"].items() if value is not None}
        return {**fields, "counters": counters}


def decode_pointer(data: bytes) -> CheckpointName:
    """The name in `.coach_checkpoint`; RecordError if damaged."""
    return checkpoint_name(data.decode(errors="replace"))
