"""What the trainer tells the other learner processes.

Messages go through standard input; their tensors follow in the process group.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from drcli.learn.compute import Compute
from drcli.learn.gradient_group import GradientGroup
from drcli.learn.rollout_buffer import Rollout
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata

Kinds = tuple[tuple[str, tuple[int, ...], torch.dtype], ...]


@dataclass(frozen=True)
class Join:
    rank: int
    size: int
    port: int


@dataclass(frozen=True)
class Build:
    metadata: ModelMetadata
    parameters: Hyperparameters
    compute: Compute


@dataclass(frozen=True)
class Update:
    """Weights, the optimizer's state and the rollout follow.

    `memory`: new gradient memory, with a file unless there is no room; None if nothing changes.
    """

    optimizer: Kinds
    rollout: Kinds
    seed: int
    steps_before: int
    lr_factor: float
    critic_warmup: int
    memory: tuple[Path | None, int] | None


@dataclass(frozen=True)
class Remember:
    rollout: Kinds


Message = Build | Update | Remember


def columns_of(rollout: Rollout) -> dict[str, Tensor]:
    columns = {}
    for field in fields(Rollout):
        column = getattr(rollout, field.name)
        column = column.view(np.uint8) if column.dtype == np.bool_ else column
        columns[field.name] = torch.from_numpy(np.require(column, requirements=("C", "W")))
    return columns


def rollout_from(columns: Mapping[str, Tensor]) -> Rollout:
    arrays = {name: column.numpy() for name, column in columns.items()}
    return Rollout(**(arrays | {each: arrays[each].view(np.bool_) for each in ("cut", "learned")}))


def kinds_of(tensors: Mapping[str, Tensor]) -> Kinds:
    return tuple((name, tuple(each.shape), each.dtype) for name, each in tensors.items())


def received(group: GradientGroup, kinds: Kinds, device: torch.device) -> dict[str, Tensor]:
    tensors = {name: torch.empty(shape, dtype=dtype, device=device) for name, shape, dtype in kinds}
    group.from_trainer(tensors.values())
    return tensors
