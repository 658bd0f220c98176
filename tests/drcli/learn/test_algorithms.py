"""A row and a learner are all that an algorithm needs."""

from dataclasses import dataclass

import pytest
import torch

from drcli.convert.build_network import build_policy
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import ALGORITHMS, Algorithm, AlgorithmConfig
from drcli.learn.compute import Compute
from drcli.learn.learner import Learner
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.train.learner_group import build_learner

CPU = Compute(torch.device("cpu"), bf16=False, reason="test")


@dataclass(frozen=True)
class Config(AlgorithmConfig):
    beta_entropy: float = 0.5


class Example(Learner):
    """Learns nothing."""

    def update(self, *_: object, **__: object) -> list[object]:
        return []


@pytest.fixture
def metadata(monkeypatch) -> ModelMetadata:
    row = Algorithm(
        "example",
        "Example",
        "Example (example): a list of actions",
        Config,
        f"{__name__}:Example",
        refuses={"additive_noise": "is not for example"},
    )
    monkeypatch.setitem(ALGORITHMS, row.name, row)
    return ModelMetadata.from_bytes(
        b'{"training_algorithm": "Example", "action_space": [{"steering_angle": 0, "speed": 1}]}'
    )


def test_a_model_learns_with_it_by_its_own_hyperparameters(metadata):
    parameters = Hyperparameters(beta_entropy=0.25, lr=1e-4)

    learner = build_learner(metadata, parameters, CPU)

    assert isinstance(learner, Example)
    assert learner.config == Config(beta_entropy=0.25, lr=1e-4)
    assert isinstance(build_policy(metadata, parameters), ActorCritic)


def test_it_says_what_it_reads_and_refuses(metadata):
    algorithm = metadata.algorithm

    assert algorithm.reads("beta_entropy")
    assert algorithm.reads("stack_size")
    assert not algorithm.reads("num_epochs")
    conflict = Hyperparameters(exploration_type="additive_noise").conflict(
        algorithm, continuous=False
    )
    assert conflict == "exploration_type=additive_noise is not for example."
