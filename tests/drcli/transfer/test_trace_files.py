"""Traces of a model are found, and none of a model inside it."""

import pytest

from drcli.base.errors import SettingsError
from drcli.cli.commands.action_space import traces_of_model
from drcli.model import keys
from drcli.model.model_store import ModelStore
from memory_bucket import MemoryBucket

TRACE = b"episode,steps,steer,throttle,progress,tstamp\n0,0,5.0,2.0,1.0,0.1\n"


@pytest.mark.parametrize("inner", ["model/inner", "model/1"])
def test_traces_of_a_model_inside_are_not_its_own(inner):
    bucket = MemoryBucket()
    for prefix in ("model", inner):
        bucket.put(keys.coach_checkpoint(prefix), b"1_Step-1.ckpt")
        bucket.put(keys.training_trace(prefix, 3), TRACE)
    bucket.put(keys.training_trace("model", 3, worker=2, workers=3), TRACE)
    bucket.put(keys.evaluation_trace("model", "20260101000000"), TRACE)

    found = [file.name for file in traces_of_model(ModelStore(bucket, "model"))]

    assert found == [
        keys.evaluation_trace("model", "20260101000000"),
        keys.training_trace("model", 3, worker=2, workers=3),
        keys.training_trace("model", 3),
    ]


def test_a_model_without_traces_is_refused():
    with pytest.raises(SettingsError, match="has no trace of a drive"):
        traces_of_model(ModelStore(MemoryBucket(), "model"))
