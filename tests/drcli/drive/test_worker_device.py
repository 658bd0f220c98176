"""Where simulation workers compute cameras and policy."""

import pytest
import torch

from drcli.drive import build_race
from drcli.drive.build_race import choose_worker_device


@pytest.fixture
def two_gpus(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "set_device", lambda number: None)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda number: f"card {number}")
    monkeypatch.setattr(build_race, "find_spec", lambda name: object())


def test_gpus_are_given_out_in_turn(two_gpus):
    chosen = [choose_worker_device("auto", worker) for worker in range(3)]

    assert [each.gpu.index for each in chosen] == [0, 1, 0]
    assert chosen[1].reason == "on card 1"


def test_the_processor_is_used_where_that_is_asked_for(two_gpus):
    assert choose_worker_device("cpu", 0).gpu is None


@pytest.mark.parametrize(("wanted", "is_wanted"), [("auto", True), ("gpu", False)])
def test_without_numba_cuda_the_processor_is_used_and_the_extra_is_named(
    two_gpus, monkeypatch, wanted, is_wanted
):
    monkeypatch.setattr(build_race, "find_spec", lambda name: None)

    chosen = choose_worker_device(wanted, 0)

    assert chosen.gpu is None
    assert "drcli[gpu]" in chosen.reason
    assert chosen.is_wanted == is_wanted


def test_without_a_gpu_the_processor_is_used(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)

    chosen = choose_worker_device("gpu", 0)

    assert chosen.gpu is None
    assert "PyTorch finds no GPU" in chosen.reason
    assert not chosen.is_wanted
