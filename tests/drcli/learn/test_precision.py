import numpy as np
import pytest
import torch

from drcli.learn import precision
from drcli.learn.policy import PolicySpec
from drcli.learn.precision import choose_compute


@pytest.fixture
def tried(monkeypatch):
    """Speeds in fp32 and bf16 to pretend; returns the batch sizes that were tried."""
    sizes: list[int] = []

    def pretend(fp32: float, bf16: float) -> list[int]:
        def speed(compute, spec, batch_size, seconds):
            sizes.append(batch_size)
            return bf16 if compute.bf16 else fp32

        monkeypatch.setattr(precision, "_samples_per_s", speed)
        return sizes

    return pretend


def test_the_faster_format_is_taken_and_the_reason_names_both_speeds(tried):
    tried(fp32=100.0, bf16=300.0)

    compute = choose_compute("auto", PolicySpec(2), batch_size=64, threads=1)

    assert compute.bf16
    assert "100" in compute.reason
    assert "300" in compute.reason


def test_a_hopeless_format_is_not_tried_on_a_whole_minibatch(tried):
    sizes = tried(fp32=100.0, bf16=10.0)

    compute = choose_compute("auto", PolicySpec(2), batch_size=64, threads=1)

    assert not compute.bf16
    assert 64 not in sizes


@pytest.mark.parametrize(("wanted", "bf16"), [("fp32", False), ("bf16", True)])
def test_a_racer_who_insists_gets_the_format_untried(tried, wanted, bf16):
    sizes = tried(fp32=1.0, bf16=1.0)

    compute = choose_compute(wanted, PolicySpec(2), batch_size=64, threads=1)

    assert compute.bf16 == bf16
    assert sizes == []


def test_both_formats_really_run(monkeypatch):
    monkeypatch.setattr(precision, "TRIAL_S", 0.0)

    compute = choose_compute("auto", PolicySpec(2), batch_size=2, threads=1)

    assert compute.device.type == ("cuda" if torch.cuda.is_available() else "cpu")


def test_choosing_leaves_the_arithmetic_of_everybody_else_alone():
    smallest = np.array([2.0**-1074])

    choose_compute("fp32", PolicySpec(2), batch_size=8, threads=1)

    assert (smallest * 1.0)[0] > 0.0
