"""Weights are published at once; what nobody waits for follows, and its failure is not lost."""

import logging

import pytest
import torch
from safetensors.torch import load

from drcli.base.errors import StorageError
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute
from drcli.learn.policy import PolicySpec
from drcli.learn.ppo import PPO
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.model.traces import TraceRetention
from drcli.records.checkpoint import CheckpointName, Counters
from drcli.train import checkpoint_publisher
from drcli.train.checkpoint_publisher import CheckpointPublisher
from memory_bucket import MemoryBucket
from small_model import put_small_model

COMPACT = "COMPACT_CONVOLUTIONAL_NETWORK"
CPU = Compute(torch.device("cpu"), bf16=False, reason="test")


@pytest.fixture
def bucket():
    bucket = MemoryBucket()
    put_small_model(bucket, "model", numbers=(0,))
    return bucket


@pytest.fixture
def store(bucket):
    return CheckpointStore(ModelStore(bucket, "model"))


@pytest.fixture
def learner():
    torch.set_num_threads(1)
    learner = PPO(ActorCritic(PolicySpec(4, network=COMPACT)), PPOConfig(), CPU)
    for parameter in learner.model.parameters():
        parameter.grad = torch.ones_like(parameter)
    learner.optimizer.step()
    return learner


@pytest.fixture
def publisher(bucket, store):
    """Makes a publisher whose process is ending or not."""
    made = []

    def make(*, ending: bool = False) -> CheckpointPublisher:
        traces = TraceRetention(ModelStore(bucket, "model"), 1, 0)
        made.append(CheckpointPublisher(store, traces, lambda: ending))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.mark.parametrize("ending", [False, True])
def test_a_checkpoint_gets_its_optimizer_state_and_an_ending_process_publishes_both_at_once(
    store, learner, publisher, monkeypatch, ending
):
    late = []
    attach = CheckpointStore.attach_optimizer
    monkeypatch.setattr(
        CheckpointStore,
        "attach_optimizer",
        lambda self, record, state: (late.append(record.name), attach(self, record, state)),
    )
    publishing = publisher(ending=ending)

    publishing.publish(CheckpointName(1, 100), learner, Counters())
    publishing.join()

    found = store.load_latest(with_optimizer=True)
    assert found.record.name == "1_Step-100.ckpt"
    assert load(found.optimizer).keys() == learner.optimizer.tensors().keys()
    assert late == ([] if ending else ["1_Step-100.ckpt"])


def test_an_upload_that_failed_is_raised_before_anything_else_is_published(
    store, learner, publisher
):
    def refuse() -> None:
        raise StorageError("The disk is full.", remedy="")

    publishing = publisher()
    publishing.submit(refuse)

    with pytest.raises(StorageError, match="The disk is full"):
        publishing.publish(CheckpointName(1, 100), learner, Counters())

    assert store.load_latest().record.number == 0
    publishing.publish(CheckpointName(1, 100), learner, Counters())
    assert store.load_latest().record.number == 1


def test_traces_that_cannot_be_deleted_are_no_reason_to_end(
    learner, publisher, monkeypatch, caplog
):
    def refuse(*_: object) -> None:
        raise StorageError("The bucket is gone.", remedy="")

    monkeypatch.setattr(TraceRetention, "apply", refuse)
    monkeypatch.setattr(checkpoint_publisher, "_logger", logging.getLogger("publisher"))
    publishing = publisher()

    publishing.publish(CheckpointName(1, 100), learner, Counters())
    publishing.join()

    assert "Old traces were not deleted: The bucket is gone." in caplog.messages
