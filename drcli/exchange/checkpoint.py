"""What is known of a checkpoint without reading its weights: its name and a JSON record."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import JsonRecord, Misfit
from drcli.exchange.iteration import IterationRecord

CHECKPOINT_NAME = re.compile(r"(\d+)_Step-(\d+)\.ckpt")


@dataclass(frozen=True, order=True)
class CheckpointName:
    """A checkpoint's place in the training: compared by number, then by steps.

    Args:
        number: Counts the checkpoints of a model from 0.
        steps: Environment steps learned from until then.
    """

    number: int
    steps: int

    @classmethod
    def parse(cls, name: str) -> "CheckpointName | None":
        """Read `12_Step-7824.ckpt`; None when the text is not such a name."""
        found = CHECKPOINT_NAME.fullmatch(name.strip())
        return cls(int(found[1]), int(found[2])) if found else None

    def __str__(self) -> str:
        return f"{self.number}_Step-{self.steps}.ckpt"


def checkpoint_name(name: str) -> CheckpointName:
    """The same, for what has to be the name of a checkpoint.

    Raises:
        Misfit: It is something else.
    """
    parsed = CheckpointName.parse(name)
    if parsed is None:
        raise Misfit(f"{json.dumps(name)[:60]} is not the name of a checkpoint")
    return parsed


@dataclass(frozen=True)
class Counters:
    """What a trainer continues with, beside the weights.

    Attributes:
        episodes: Training episodes learned from.
        elapsed_s: Wall time of training, without the time it was stopped.
        number_format: Of the weights while they are trained, such as `fp32`.
        learned: The iteration that made the weights, None for the first ones.
        seed: Of the run.
        inputs: The parameter files by name, to bring them back where they are lost.
    """

    episodes: int = 0
    elapsed_s: float = 0.0
    number_format: str | None = None
    learned: IterationRecord | None = None
    seed: int | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class CheckpointRecord(JsonRecord):
    """The object beside a checkpoint's tensors.

    Attributes:
        name: For instance `12_Step-7824.ckpt`.
        tensors: What the weights must look like.
        optimizer: The same of the optimizer state, None where there is none.
        sim_time_s: Simulated seconds driven until then.
        counters: What the trainer continues with.
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
        """The record of the checkpoint of some name; raises Misfit where it is of another."""
        record = cls.decode(data)
        if record.name != name:
            raise Misfit(f"it describes {record.name}")
        return record

    @property
    def number(self) -> int:
        """The checkpoint's number."""
        return checkpoint_name(self.name).number

    @property
    def steps(self) -> int:
        """Environment steps learned from until then."""
        return checkpoint_name(self.name).steps

    def to_json(self) -> dict[str, Any]:
        """The record as JSON: counters that are unknown are left out, NaN becomes null."""
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


def encode_pointer(name: CheckpointName) -> bytes:
    """The pointer `.coach_checkpoint`: the name as plain text."""
    return str(name).encode()


def decode_pointer(data: bytes) -> CheckpointName:
    """The checkpoint that a pointer names.

    Raises:
        Misfit: It holds something else.
    """
    name = CheckpointName.parse(data.decode(errors="replace"))
    if name is None:
        raise Misfit("it does not name a checkpoint")
    return name
