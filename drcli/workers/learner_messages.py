"""What the trainer tells the other learner processes of its machine.

A message goes through the standard input of a process; the tensors that belong to it follow in the
process group.
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
"""Name, shape and number format of tensors."""


@dataclass(frozen=True)
class Join:
    """Join the process group.

    Attributes:
        rank: Number of the process.
        size: How many processes there are, with the trainer.
        port: Where they find each other on this machine.
    """

    rank: int
    size: int
    port: int


@dataclass(frozen=True)
class Build:
    """Build the learner of a training or of a stage."""

    metadata: ModelMetadata
    parameters: Hyperparameters
    compute: Compute


@dataclass(frozen=True)
class Update:
    """Take part in an update. Weights, the optimizer's state and the rollout follow.

    Attributes:
        optimizer: Tensors of the optimizer's state.
        rollout: Columns of the rollout.
        seed: As for the update.
        steps_before: As for the update.
        lr_factor: Of the learner.
        critic_warmup: Of the learner.
        memory: File and number of parameters of new memory for gradients; no file if there is no
            room for it; None if nothing changes.
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
    """Remember a rollout, which follows, without learning from it."""

    rollout: Kinds


Message = Build | Update | Remember


def columns_of(rollout: Rollout) -> dict[str, Tensor]:
    """The columns of a rollout as tensors, by name."""
    columns = {}
    for field in fields(Rollout):
        column = getattr(rollout, field.name)
        column = column.view(np.uint8) if column.dtype == np.bool_ else column
        columns[field.name] = torch.from_numpy(np.require(column, requirements=("C", "W")))
    return columns


def rollout_from(columns: Mapping[str, Tensor]) -> Rollout:
    """The rollout with such columns."""
    arrays = {name: column.numpy() for name, column in columns.items()}
    return Rollout(**(arrays | {each: arrays[each].view(np.bool_) for each in ("cut", "learned")}))


def kinds_of(tensors: Mapping[str, Tensor]) -> Kinds:
    """What another process needs to know to receive tensors."""
    return tuple((name, tuple(each.shape), each.dtype) for name, each in tensors.items())


def received(group: GradientGroup, kinds: Kinds, device: torch.device) -> dict[str, Tensor]:
    """Tensors that the trainer sends now."""
    tensors = {name: torch.empty(shape, dtype=dtype, device=device) for name, shape, dtype in kinds}
    group.from_trainer(tensors.values())
    return tensors
