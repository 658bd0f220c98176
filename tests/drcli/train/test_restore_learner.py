"""What a trainer forgets when it goes on from an older checkpoint."""

from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import save as save_tensors

from drcli.bucket.bucket import ObjectMissing
from drcli.convert.imported_policy import CRITIC_WARMUP
from drcli.learn.compute import Compute
from drcli.model import keys
from drcli.model.best_checkpoint import read_evaluation, write_evaluation
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.records.scores import EvaluationResult
from drcli.train.checkpoint_publisher import forget_evaluations, restore_learner
from drcli.train.learner_group import build_learner
from memory_bucket import MemoryBucket


def test_results_of_checkpoints_that_do_not_count_are_forgotten_and_others_stay():
    bucket = MemoryBucket()
    for number in (2, 3):
        bucket.put(keys.checkpoint_tensors("model", f"{number}_Step-{number}00.ckpt"), b"weights")
    for number in (1, 2, 3):
        result = EvaluationResult(f"{number}_Step-{number}00.ckpt", [50.0], [1.0], [])
        write_evaluation(ModelStore(bucket, "model"), number, result)

    forget_evaluations(ModelStore(bucket, "model"), newest=2)

    assert read_evaluation(ModelStore(bucket, "model"), 2).checkpoint == "2_Step-200.ckpt"
    for number in (1, 3):
        with pytest.raises(ObjectMissing):
            read_evaluation(ModelStore(bucket, "model"), number)


@pytest.mark.parametrize(
    ("before", "after", "warmup"),
    [("teacher", "camera", CRITIC_WARMUP), ("camera", "teacher", 0), ("camera", "camera", 0)],
)
def test_a_critic_that_is_new_because_the_teacher_has_gone_learns_alone_first(
    before, after, warmup
):
    metadata = ModelMetadata.from_bytes(
        b'{"action_space": [{"steering_angle": 0, "speed": 1}], "version": "5"}'
    )
    compute = Compute(torch.device("cpu"), bf16=False, reason="test")
    one, other = (
        build_learner(metadata, Hyperparameters(training_method=method), compute)
        for method in (before, after)
    )
    record = SimpleNamespace(name="1_Step-9.ckpt", counters=Counters())
    tensors = save_tensors({k: v.contiguous() for k, v in one.model.state_dict().items()})

    restore_learner(other, SimpleNamespace(record=record, tensors=tensors, optimizer=None))

    assert other.critic_warmup == warmup
    assert torch.equal(other.model.policy_head.weight, one.model.policy_head.weight)
