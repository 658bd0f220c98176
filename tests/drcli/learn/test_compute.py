import os
import re
import subprocess
import sys

import numpy as np
import pytest
import torch

from drcli.learn import compute as precision
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute, choose_compute
from drcli.learn.policy import PolicySpec
from drcli.learn.ppo import PPO
from drcli.learn.rollout_buffer import Rollout


@pytest.fixture
def processor(monkeypatch):
    """Pretend a processor with or without instructions for bfloat16, and no GPU."""
    for name in ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)

    def pretend(amx: bool, vectors: bool = False) -> None:
        known = {"amx_bf16": amx, "avx512_bf16": vectors}
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: known)

    return pretend


@pytest.mark.parametrize(
    ("amx", "vectors", "name"),
    [(True, True, "AMX"), (False, True, "AVX512_BF16"), (False, False, None)],
)
def test_the_format_follows_from_the_processor_and_the_reason_names_it(
    processor, amx, vectors, name
):
    processor(amx, vectors)

    compute = choose_compute("auto", batch_size=64, threads=1)

    assert compute.bf16 is (name is not None)
    assert compute.reason.startswith("bf16" if name else "fp32")
    assert f"({name})" in compute.reason if name else "no instructions" in compute.reason


@pytest.mark.parametrize(("has_bf16", "name"), [(True, "bf16"), (False, "fp32")])
def test_on_a_gpu_its_tensor_cores_decide(processor, monkeypatch, has_bf16, name):
    processor(amx=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda **_: has_bf16)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "Some GPU")

    compute = choose_compute("auto", batch_size=64, threads=1)

    assert compute.number_format == name
    assert compute.graphs
    assert compute.reason.startswith(f"{name} on Some GPU: ")
    assert "CUDA graph" in compute.reason
    assert "AMX" not in compute.reason


@pytest.mark.parametrize(
    ("limit", "units"),
    [
        ("AVX512_CORE_BF16", "AVX512_BF16"),
        ("AVX512_CORE_FP16", "AVX512_BF16"),
        ("AVX512_CORE_VNNI", ""),
        ("avx2", ""),
        ("AVX512_CORE_AMX", "AMX"),
        ("DEFAULT", "AMX"),
    ],
)
def test_a_limit_on_the_kernels_instructions_is_obeyed(processor, monkeypatch, limit, units):
    processor(amx=True, vectors=True)
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", limit)

    assert precision.bfloat16_units() == units


@pytest.mark.parametrize("amx", [True, False])
@pytest.mark.parametrize(("wanted", "bf16"), [("fp32", False), ("bf16", True)])
def test_a_racer_who_insists_gets_the_format(processor, amx, wanted, bf16):
    processor(amx)

    assert choose_compute(wanted, batch_size=64, threads=1, before="fp32").bf16 == bf16


def test_a_training_in_float32_keeps_that_on_another_processor_and_says_so(processor):
    processor(amx=True)

    compute = choose_compute("auto", batch_size=64, threads=1, before="fp32")

    assert compute.number_format == "fp32"
    assert "kept from the start of this training" in compute.reason
    assert "DR_TORCH_PRECISION" in compute.reason


def test_a_training_in_bfloat16_goes_on_in_float32_where_that_is_emulated_unless_it_is_pinned():
    # The limit switches the instructions off in the libraries, and not only in our own look.
    code = (
        "from drcli.learn.compute import choose_compute as choose\n"
        "for wanted in ('auto', 'bf16'):\n"
        "    found = choose(wanted, batch_size=64, threads=1, before='bf16')\n"
        "    print(found.number_format, found.warning)"
    )
    limited = {**os.environ, "ONEDNN_MAX_CPU_ISA": "AVX2", "CUDA_VISIBLE_DEVICES": ""}

    said = subprocess.run(
        [sys.executable, "-c", code], env=limited, capture_output=True, text=True, check=True
    ).stdout

    auto, pinned = said.splitlines()
    slow = r"bf16 takes (\S+) times as long as fp32 here"
    assert all(float(re.search(slow, line)[1]) > 1.0 for line in (auto, pinned))
    assert re.match(r"fp32 .*goes on in fp32\. DR_TORCH_PRECISION=bf16", auto)
    assert re.match(r"bf16 .*DR_TORCH_PRECISION=bf16 in system\.env asks for it", pinned)


def test_a_checkpoint_that_names_no_format_gets_that_of_the_processor(processor):
    processor(amx=True)

    assert choose_compute("auto", batch_size=64, threads=1, before=None).bf16


@pytest.mark.parametrize(
    ("learner", "vectors", "expected"),
    [
        ("bf16", True, torch.bfloat16),
        ("bf16", False, torch.float32),
        ("fp32", True, torch.float32),
        (None, True, torch.float32),
    ],
)
def test_cars_are_driven_in_the_learner_s_format_where_it_is_fast(
    processor, learner, vectors, expected
):
    processor(amx=False, vectors=vectors)

    assert precision.driving_format(learner) is expected


def test_this_processor_is_known():
    assert precision.bfloat16_units() in ("AMX", "AVX512_BF16", "")
    assert "amx_bf16" in torch.cpu.get_capabilities() or not sys.platform.startswith("linux")


def test_choosing_leaves_the_arithmetic_of_everybody_else_alone():
    smallest = np.array([2.0**-1074])

    choose_compute("fp32", batch_size=8, threads=1)

    assert (smallest * 1.0)[0] > 0.0


@pytest.mark.parametrize("bf16", [False, True])
def test_an_update_beside_a_busy_program_gives_the_same_bytes(bf16):
    quiet = _updated(bf16)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(3)]
    try:
        beside = [_updated(bf16) for _ in range(2)]
    finally:
        for process in busy:
            process.kill()
            process.wait()

    for weights in beside:
        assert all(torch.equal(one, other) for one, other in zip(quiet, weights, strict=True))


def _updated(bf16: bool) -> list[torch.Tensor]:
    """Weights after an update by two threads, each with a part of every minibatch."""
    torch.manual_seed(0)
    model = ActorCritic(PolicySpec(3, network="COMPACT_CONVOLUTIONAL_NETWORK"))
    compute = Compute(torch.device("cpu"), bf16, "test", threads=2, parts=2)
    random = np.random.default_rng(0)
    steps = 64
    rollout = Rollout(
        random.integers(0, 255, (steps, 1, 120, 160), dtype=np.uint8),
        random.integers(0, 3, steps),
        np.full(steps, -1.1, np.float32),
        np.zeros(steps),
        random.random(steps),
        np.array([steps]),
        last_values=np.zeros(1),
        cut=np.zeros(1, np.bool_),
        scans=np.empty((steps, 0), np.float32),
        states=np.empty((steps, 0), np.float32),
    )
    PPO(model, PPOConfig(batch_size=32, num_epochs=2, lr=1e-3), compute).update(rollout, 1)
    return [tensor.clone() for tensor in model.state_dict().values()]
