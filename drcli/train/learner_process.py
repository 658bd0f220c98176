"""Another learner process: `python -m drcli.train.learner_process`.

It ends with the trainer.
"""

import pickle
import signal
import sys
from typing import BinaryIO

import torch
from torch import distributed

from drcli.learn.compute import flush_denormals
from drcli.learn.data_parallel import GradientGroup, LearnerLostError
from drcli.learn.learner import Learner
from drcli.learn.update_result import NonFiniteLossError
from drcli.train.learner_group import (
    Build,
    Update,
    attach,
    build_learner,
    join_group,
    received,
    rollout_from,
)

CPU = torch.device("cpu")


def take_part(messages: BinaryIO, group: GradientGroup) -> None:
    learner: Learner | None = None
    while True:
        try:
            message = pickle.load(messages)
        except EOFError:
            return
        if isinstance(message, Build):
            compute = message.compute
            torch.set_num_threads(compute.threads)
            learner = build_learner(message.metadata, message.parameters, compute, group)
            continue
        assert learner is not None
        if isinstance(message, Update):
            _update(learner, group, message)
        else:
            learner.remember(rollout_from(received(group, message.rollout, CPU)))


def _update(learner: Learner, group: GradientGroup, message: Update) -> None:
    device = learner.compute.device
    if message.memory is not None:
        path, count = message.memory
        slots = None if path is None else attach(path, group.size, count)
        group.share_memory(slots)
        if path is not None:
            group.of_all(0)
    for tensor in learner.model.state_dict().values():
        sent = torch.empty_like(tensor, memory_format=torch.contiguous_format)
        group.from_trainer([sent])
        tensor.copy_(sent)
    learner.optimizer.restore(received(group, message.optimizer, device))
    learner.lr_factor, learner.critic_warmup = message.lr_factor, message.critic_warmup
    rollout = rollout_from(received(group, message.rollout, CPU))
    try:
        learner.update(rollout, message.seed, steps_before=message.steps_before)
    except NonFiniteLossError:
        return  # the trainer says so


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the trainer decides when to end
    flush_denormals()
    rank, size, port = map(int, sys.argv[1:])
    sys.stdout.write("\n")  # so that the trainer waits for the group only if everybody comes
    sys.stdout.flush()
    # The type is ignored because torch does not export it by name.
    store = distributed.TCPStore(  # type: ignore[attr-defined]
        "127.0.0.1", port, size
    )
    try:
        join_group(store, rank, size)
        take_part(sys.stdin.buffer, GradientGroup())
    except LearnerLostError:
        return
    except (MemoryError, RuntimeError) as error:
        sys.stderr.write(f"Learner process {rank} failed: {type(error).__name__}: {error}\n")
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
