"""The learner of a training, in the trainer alone or in several processes (DR_TRAIN_LEARNERS).

Only the trainer uses the bucket. The others get everything with each update, so a new one has
lost nothing.
"""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, fields
from datetime import timedelta
from mmap import mmap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, distributed

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.log import get_logger, plain
from drcli.config.run_config import TrainConfig
from drcli.convert.build_network import policy_spec
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig, algorithm_config
from drcli.learn.compute import Compute, choose_compute, gpu_count
from drcli.learn.data_parallel import GradientGroup, LearnerLostError
from drcli.learn.learner import Learner, learner_of
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.taught import TaughtLearner
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.training_state import Rollbacks
from drcli.workers.cores import learning_threads

if TYPE_CHECKING:
    from torch.distributed.distributed_c10d import Store

_logger = get_logger(__name__)

# Memory in which the learner processes of one machine exchange gradients.
#
# gloo sends them through the network: on two cores (AMD EPYC) 19 ms for the shallow network's 23
# MB, as long as half of a step of 64 samples.


FOLDER = Path("/dev/shm")
"""In main memory on Linux."""


def create(size: int, count: int) -> tuple[Path, Tensor] | None:
    """A file, and the slots of `GradientGroup.share_memory`; None if there is no room.

    The caller deletes the file when all have opened it.
    """
    try:
        number, name = tempfile.mkstemp(prefix="drcli-gradients-", dir=FOLDER)
    except OSError:
        return None
    path = Path(name)
    try:
        # Without it, a lack of memory would show later, as a bus error.
        os.posix_fallocate(number, 0, _bytes(size, count))
        return path, _slots(number, size, count)
    except OSError:
        path.unlink()
        return None
    finally:
        os.close(number)


def attach(path: Path, size: int, count: int) -> Tensor:
    number = os.open(path, os.O_RDWR)
    try:
        return _slots(number, size, count)
    finally:
        os.close(number)


def _slots(number: int, size: int, count: int) -> Tensor:
    memory = mmap(number, _bytes(size, count))
    return torch.frombuffer(memory, dtype=torch.float32).view(2, size, count)


def _bytes(size: int, count: int) -> int:
    return 2 * size * count * 4


# What the trainer tells the other learner processes.
#
# Messages go through standard input; their tensors follow in the process group.


Kinds = tuple[tuple[str, tuple[int, ...], torch.dtype], ...]


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


MOST_SILENCE = timedelta(minutes=10)
"""A process that has ended is noticed at once."""

LOOPBACK = {"linux": "lo", "darwin": "lo0"}
"""For gloo, which fails on a machine whose own name is unknown to its network."""


class LearnerGroup:
    def __init__(self, size: int) -> None:
        """Start the others, and wait for them.

        Raises:
            SettingsError: There are fewer GPUs than processes.
            WorkerDied: A process has not started.
        """
        gpus = gpu_count() or size
        if gpus < size:
            raise SettingsError(
                f"DR_TRAIN_LEARNERS in system.env is {size}, but the trainer has "
                f"{gpus} GPU{'s' * (gpus != 1)}.",
                remedy="Set it to that number, or name more of them in DR_SAGEMAKER_CUDA_DEVICES.",
            )

        self.size = size
        self._parameters = 0
        # The type is ignored because torch does not export it by name.
        store = distributed.TCPStore(  # type: ignore[attr-defined]
            "127.0.0.1", 0, size, is_master=True, wait_for_workers=False
        )
        self._processes = [
            # Each is a stranger to the others' pipes, so that it sees the end of the trainer.
            subprocess.Popen(
                [
                    *(sys.executable, "-P", "-m", "drcli.train.learner_process"),
                    *map(str, (rank, size, store.port)),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for rank in range(1, size)
        ]
        try:
            for process in self._processes:
                assert process.stdout is not None
                if not process.stdout.read(1):
                    raise LearnerLostError("it ended before its first message")
            join_group(store, 0, size)
            self.gradients = GradientGroup()
        except (LearnerLostError, RuntimeError) as error:
            self.close()
            raise learner_died(error) from error

    def begin_update(
        self,
        learner: Learner,
        rollout: Rollout,
        seed: int,
        steps_before: int,
    ) -> None:
        """Let the others take part in the next update.

        Raises:
            LearnerLostError: A process has ended.
        """
        memory = self._new_memory(learner)
        columns, state = columns_of(rollout), learner.optimizer.tensors()
        weights = learner.model.state_dict()
        self.tell(
            Update(
                optimizer=kinds_of(state),
                rollout=kinds_of(columns),
                seed=seed,
                steps_before=steps_before,
                lr_factor=learner.lr_factor,
                critic_warmup=learner.critic_warmup,
                memory=memory,
            )
        )
        if memory is not None and memory[0] is not None:
            self.gradients.of_all(0)  # everybody has opened it
            memory[0].unlink()
        self.gradients.from_trainer(tensor.contiguous() for tensor in weights.values())
        self.gradients.from_trainer(state.values())
        self.gradients.from_trainer(columns.values())

    def _new_memory(self, learner: Learner) -> tuple[Path | None, int] | None:
        count = sum(p.numel() for p in learner.model.parameters() if p.requires_grad)
        if learner.compute.device.type != "cpu" or count == self._parameters:
            return None
        self._parameters = count
        created = create(self.size, count)
        path, slots = created or (None, None)
        self.gradients.share_memory(slots)
        return path, count

    def remember(self, rollout: Rollout) -> None:
        columns = columns_of(rollout)
        self.tell(Remember(kinds_of(columns)))
        self.gradients.from_trainer(columns.values())

    def close(self) -> None:
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    if pipe is not None:
                        pipe.close()
        if distributed.is_initialized():
            distributed.destroy_process_group()

    def tell(self, message: Build | Update | Remember) -> None:
        """LearnerLostError if one of them has ended."""
        try:
            for process in self._processes:
                assert process.stdin is not None
                pickle.dump(message, process.stdin)
                process.stdin.flush()
        except BrokenPipeError:
            raise LearnerLostError("it does not listen any more") from None


def join_group(store: "Store", rank: int, size: int) -> None:
    if sys.platform in LOOPBACK:
        os.environ.setdefault("GLOO_SOCKET_IFNAME", LOOPBACK[sys.platform])
    backend = "gloo"
    if torch.cuda.is_available():
        torch.cuda.set_device(rank)
        backend = "cpu:gloo,cuda:nccl"
    distributed.init_process_group(
        backend, store=store, rank=rank, world_size=size, timeout=MOST_SILENCE
    )


def learner_died(error: Exception) -> WorkerDied:
    """The trainer ends, and starts again."""
    return WorkerDied(
        f"A learner process of DR_TRAIN_LEARNERS has ended: {error}.",
        remedy="Read its reason with `dr-logs trainer`; if memory is short, set "
        "DR_TRAIN_LEARNERS to 1 in system.env.",
    )


@contextmanager
def learner_group(size: int) -> Iterator[LearnerGroup | None]:
    """None for one process, the trainer itself."""
    if size == 1:
        yield None
        return
    with closing(LearnerGroup(size)) as group:
        yield group


# Builds the learner from model_metadata.json and hyperparameters.json.


def build_learner(
    metadata: ModelMetadata,
    parameters: Hyperparameters,
    compute: Compute,
    group: GradientGroup | None = None,
) -> Learner:
    spec = policy_spec(metadata, parameters)
    if parameters.taught:
        config = algorithm_config(PPOConfig, parameters)
        return TaughtLearner(ActorCritic(spec), config, compute)
    algorithm = metadata.algorithm
    learner, own = learner_of(algorithm), algorithm_config(algorithm.config, parameters)
    return learner(learner.network(spec, own), own, compute, group)


def learner_of_training(
    train: TrainConfig,
    metadata: ModelMetadata,
    parameters: Hyperparameters,
    rollbacks: Rollbacks,
    number_format: str | None,
    group: LearnerGroup | None = None,
) -> Learner:
    """`number_format` is that with which the training began.

    The processes of a `group` build the same learner and share the cores.
    """
    plain.info("Using the following hyper-parameters")
    plain.info(parameters.canonical_json(metadata.training_algorithm))
    size = 1 if group is None else group.size
    compute = choose_compute(
        train.torch_precision,
        max(1, parameters.batch_size // size),
        max(1, learning_threads(train) // size),
        before=number_format,
    )
    where = f" in each of {size} processes" if size > 1 else ""
    _logger.info("Learning%s in %s", where, compute.reason)
    if compute.warning:
        _logger.warning("%s", compute.warning)
    gradients = None
    if group is not None:
        group.tell(Build(metadata, parameters, compute))
        gradients = group.gradients
    learner = build_learner(metadata, parameters, compute, gradients)
    learner.lr_factor = rollbacks.factor(learner.config.lr)
    if learner.lr_factor != 1.0:
        rate = learner.lr_factor * learner.config.lr
        times = "1 rollback" if rollbacks.count == 1 else "the rollbacks"
        _logger.info("The learning rate is %.3g since %s.", rate, times)
    return learner
