"""Failures that mean that memory ran out, and those that only look like it."""

import errno

import numpy as np
import pytest
import torch

from drcli.workers.heartbeat_thread import memory_shortage
from drsim.errors import RewardError


def raised(call):
    with pytest.raises((MemoryError, RuntimeError, RewardError)) as caught:
        call()
    return caught.value


def reward_error():
    try:
        raise MemoryError
    except MemoryError as cause:
        raise RewardError("failed", kind="raises", reason="MemoryError") from cause


@pytest.mark.parametrize(
    "call",
    [
        lambda: [0] * 10**16,
        lambda: np.ones(10**17),
        lambda: torch.ones(10**16),
        reward_error,
    ],
)
def test_memory_ran_out(call):
    found = memory_shortage(raised(call))

    assert found is not None
    assert found.memory
    assert not found.final
    assert found.message.startswith("ran out of memory: it uses ")
    assert "bug" not in found.message + found.remedy


def test_a_process_that_could_not_be_started_for_memory():
    assert memory_shortage(OSError(errno.ENOMEM, "Cannot allocate memory")).memory


def test_memory_of_a_gpu_is_another_matter():
    found = memory_shortage(torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB"))

    assert not found.memory
    assert "GPU" in found.message
    assert "batch_size" in found.remedy


@pytest.mark.parametrize(
    "error",
    [ValueError("allocate memory"), RuntimeError("no such thing"), OSError(errno.ENOSPC, "full")],
)
def test_other_failures(error):
    assert memory_shortage(error) is None
