"""What a trainer forgets when it goes on from an older checkpoint."""

import pytest

from drcli.exchange.scores import EvaluationResult
from drcli.store import keys
from drcli.store.best_checkpoint import read_evaluation, write_evaluation
from drcli.store.bucket import ObjectMissing
from drcli.workers.restore_learner import forget_evaluations
from memory_bucket import MemoryBucket


def test_results_of_checkpoints_that_do_not_count_are_forgotten_and_others_stay():
    bucket = MemoryBucket()
    for number in (2, 3):
        bucket.put(keys.checkpoint_tensors("model", f"{number}_Step-{number}00.ckpt"), b"weights")
    for number in (1, 2, 3):
        result = EvaluationResult(f"{number}_Step-{number}00.ckpt", [50.0], [1.0], [])
        write_evaluation(bucket, "model", number, result)

    forget_evaluations(bucket, "model", newest=2)

    assert read_evaluation(bucket, "model", 2).checkpoint == "2_Step-200.ckpt"
    for number in (1, 3):
        with pytest.raises(ObjectMissing):
            read_evaluation(bucket, "model", number)
