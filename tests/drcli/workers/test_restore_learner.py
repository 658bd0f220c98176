"""What a trainer forgets when it goes on from an older checkpoint."""

import pytest

from drcli.exchange.scores import EvaluationResult
from drcli.store.best_checkpoint import read_evaluation, write_evaluation
from drcli.store.bucket import ObjectMissing
from drcli.workers.restore_learner import forget_evaluations
from memory_bucket import MemoryBucket


def test_results_of_checkpoints_that_are_passed_over_are_forgotten_and_others_stay():
    bucket = MemoryBucket()
    for number in (1, 2, 3):
        result = EvaluationResult(f"{number}_Step-{number}00.ckpt", [50.0], [1.0], [])
        write_evaluation(bucket, "model", number, result)

    forget_evaluations(bucket, "model", after=2)

    assert read_evaluation(bucket, "model", 2).checkpoint == "2_Step-200.ckpt"
    with pytest.raises(ObjectMissing):
        read_evaluation(bucket, "model", 3)
