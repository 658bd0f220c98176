"""Steps that a GPU repeats as CUDA graphs: the same results, or the step itself."""

import numpy as np
import pytest
import torch

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig, SACConfig
from drcli.learn.compute import Compute
from drcli.learn.cuda import WARM_UP, CapturedStep, GpuPolicy, ReusedMemory
from drcli.learn.policy import Observation, PolicySpec, decide
from drcli.learn.ppo import PPO
from drcli.learn.sac import SAC
from drcli.learn.sac_networks import SACAgent
from drcli.learn.update_result import NonFiniteLossError, require_finite_losses
from made_up_rollout import made_up_rollout

CPU = torch.device("cpu")
needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU")
STEPS = 200


def test_a_step_that_is_not_captured_is_called_each_time():
    calls = []
    step = CapturedStep(lambda x: calls.append(x) or x + 1, CPU, enabled=False)

    results = [step(torch.tensor(float(number))).item() for number in range(WARM_UP + 2)]

    assert results == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert len(calls) == WARM_UP + 2
    assert step._graph is None


def test_a_step_that_cannot_be_captured_goes_on_and_says_why(monkeypatch):
    def fail(*_arguments, **_more):
        raise RuntimeError("operation not permitted when stream is capturing\nmore")

    monkeypatch.setattr(torch.cuda, "graph", fail)
    monkeypatch.setattr(torch.cuda, "CUDAGraph", lambda: None)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)
    step = CapturedStep(lambda x: x + 1, CPU, enabled=True)

    results = [step(torch.tensor([number])).item() for number in range(WARM_UP + 3)]

    assert results == list(range(1, WARM_UP + 4))
    assert step.failure == "operation not permitted when stream is capturing"


def test_memory_stays_where_it_is_for_rollouts_that_fit():
    memory = ReusedMemory(CPU)

    first = memory.place("rewards", torch.ones(100))
    second = memory.place("rewards", torch.full((110,), 2.0))
    third = memory.place("rewards", torch.full((200,), 3.0))

    assert second.data_ptr() == first.data_ptr()
    assert second[:110].eq(2.0).all()
    assert third[:200].eq(3.0).all()
    assert memory.moves == 2


def test_memory_moves_for_another_shape_or_number_format():
    memory = ReusedMemory(CPU)

    memory.place("actions", torch.zeros(10, dtype=torch.int64))
    memory.place("actions", torch.zeros(10))
    memory.place("actions", torch.zeros(10, 2))

    assert memory.moves == 3


def test_rows_are_prepared_where_they_are_kept():
    memory = ReusedMemory(CPU)

    held = memory.place("frames", torch.arange(3000.0), lambda rows: rows[:, None] * 2.0)

    assert torch.equal(held[:3000, 0], 2.0 * torch.arange(3000.0))


@pytest.mark.parametrize("bf16", [False, True])
def test_reused_memory_changes_nothing_about_an_update(bf16):
    learners = []
    for memory in (None, ReusedMemory(CPU)):
        learner = _ppo(Compute(CPU, bf16, reason="test"))
        learner._memory = memory
        for seed in (1, 2):
            learner.update(_rollout(seed), seed)
        learners.append(learner)

    for p, q in zip(learners[0].model.parameters(), learners[1].model.parameters(), strict=True):
        assert torch.equal(p, q)


def test_losses_of_an_epoch_that_are_not_finite_are_named():
    require_finite_losses({"surrogate": 0.5})

    with pytest.raises(NonFiniteLossError, match=r"surrogate 0\.5, value nan"):
        require_finite_losses({"surrogate": 0.5, "value": float("nan")})


@needs_gpu
@pytest.mark.parametrize("bf16", [False, True])
def test_a_graph_learns_what_its_operations_learn(bf16):
    torch.backends.cudnn.deterministic = True
    learners = []
    for graphs in (False, True):
        learner = _ppo(Compute(torch.device("cuda"), bf16, "test", graphs=graphs))
        stats = [learner.update(_rollout(seed), seed)[-1].metrics() for seed in (1, 2, 3)]
        learners.append((learner, stats))
    (one, ones), (other, others) = learners

    assert other._step._graph is not None
    assert other.capture_failure is None
    for a, b in zip(ones, others, strict=True):
        assert b == pytest.approx(a, rel=0.02, abs=2e-3)
    for p, q in zip(one.model.parameters(), other.model.parameters(), strict=True):
        torch.testing.assert_close(q, p, rtol=0.05, atol=2e-3)


@needs_gpu
def test_a_graph_of_soft_actor_critic_learns_what_its_operations_learn():
    torch.backends.cudnn.deterministic = True
    results = []
    for graphs in (False, True):
        torch.manual_seed(0)
        spec = PolicySpec(2, continuous=True, network="COMPACT_CONVOLUTIONAL_NETWORK")
        config = SACConfig(
            batch_size=32, sac_learning_starts=1, sac_replay_steps=1000, sac_updates_per_step=0.2
        )
        compute = Compute(torch.device("cuda"), bf16=False, reason="test", graphs=graphs)
        learner = SAC(SACAgent(spec), config, compute)
        rollout = _rollout(1, continuous=True)
        results.append((learner, learner.update(rollout, 1)[-1].metrics()))
    (_, expected), (captured, found) = results

    assert captured._step._graph is not None
    expected = {name: number for name, number in expected.items() if np.isfinite(number)}
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=0.02, abs=2e-3)


@needs_gpu
def test_a_loss_that_is_not_finite_ends_the_update_on_a_gpu():
    learner = _ppo(Compute(torch.device("cuda"), bf16=False, reason="test", graphs=True))
    learner.update(_rollout(1), 1)
    with torch.no_grad():
        learner.model.policy_head.weight[0, 0] = torch.inf

    with pytest.raises(NonFiniteLossError):
        learner.update(_rollout(2), 2)


@needs_gpu
@pytest.mark.parametrize("bf16", [False, True])
def test_a_policy_on_a_gpu_chooses_like_the_one_in_main_memory(bf16):
    torch.manual_seed(0)
    policy = ActorCritic(PolicySpec(5, network="COMPACT_CONVOLUTIONAL_NETWORK"))
    on_gpu = GpuPolicy(policy, torch.device("cuda"))
    on_gpu.follow(torch.bfloat16 if bf16 else torch.float32)
    draw = np.random.default_rng(0)
    apart = []
    for cars in (20, 20, 20, 20, 20, 13, 1):
        frames = draw.integers(0, 256, (cars, 1, 120, 160), dtype=np.uint8)
        nothing = np.empty((cars, 0), np.float32)
        seen = Observation.of_arrays(frames, nothing, nothing)
        noise, no = draw.random((cars, 2), dtype=np.float32), np.zeros(cars, bool)
        own, other = decide(policy, seen, noise, no), decide(on_gpu, seen, noise, no)
        same = own.actions == other.actions
        apart.append(np.abs(own.log_probs - other.log_probs)[same].max())
        assert same.mean() >= 0.9

    assert on_gpu._drawn._graph is not None
    assert max(apart) < (0.05 if bf16 else 0.005)


def _ppo(compute):
    torch.manual_seed(0)
    model = ActorCritic(PolicySpec(4, network="COMPACT_CONVOLUTIONAL_NETWORK"))
    return PPO(model, PPOConfig(batch_size=32, num_epochs=2), compute)


def _rollout(seed, *, continuous=False):
    return made_up_rollout(STEPS, 4, seed, continuous=continuous)
