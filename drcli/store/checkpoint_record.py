"""What is known of a checkpoint without reading its weights: a small JSON object beside them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import Misfit, built
from drcli.store.history import learned_record
from drcli.store.keys import CheckpointName


@dataclass(frozen=True)
class Record:
    """What is known of a checkpoint without reading its tensors.

    Args:
        name: For instance `12_Step-7824.ckpt`.
        tensors: What the weights must look like.
        optimizer: The same of the optimizer state, None where there is none.
        sim_time_s: Simulated seconds driven until then.
        counters: Whatever the trainer needs to continue: iteration, episodes, elapsed time.
    """

    name: str
    tensors: Fingerprint
    optimizer: Fingerprint | None = None
    sim_time_s: float = 0.0
    counters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def number(self) -> int:
        """The checkpoint's number."""
        return _parsed(self.name).number

    @property
    def steps(self) -> int:
        """Environment steps learned from until then."""
        return _parsed(self.name).steps


def checked_record(name: str, fields: Any) -> Record:
    """A record from JSON, with counters that a trainer can go on with.

    Raises:
        Misfit: It is something else.
    """
    record = built(Record, fields)
    if record.name != name:
        raise Misfit(f"it describes {json.dumps(record.name)[:60]}")
    counters = record.counters
    built(_Counters, counters)
    if counters.get("learned") is not None:
        learned_record(counters["learned"])
    return record


@dataclass(frozen=True)
class _Counters:
    """What must have the right type where the counters have it."""

    episodes: int = 0
    elapsed_s: float = 0.0
    seed: int = 0
    inputs: Mapping[str, str] = field(default_factory=dict)


def _parsed(name: str) -> CheckpointName:
    parsed = CheckpointName.parse(name)
    if parsed is None:
        raise ValueError(f"{name!r} is not the name of a checkpoint.")
    return parsed
