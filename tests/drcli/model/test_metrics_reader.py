"""Episodes are read again only where an object has changed."""

import pytest

from drcli.model.model_store import ModelStore
from drcli.records.episode_metrics import EpisodeMetrics, encode_metrics
from drcli.web.episode_routes import DrivenEpisode, MetricsReader
from memory_bucket import MemoryBucket

FOLDER = "model/metrics"


class Counted(MemoryBucket):
    """Notes what is read."""

    def __init__(self):
        super().__init__()
        self.read = []

    def get(self, key):
        self.read.append(key.rpartition("/")[2])
        return super().get(key)


def record(iteration, episode, *, phase="training", reward=10.0):
    return EpisodeMetrics(
        reward_score=reward,
        metric_time=2,
        start_time=1,
        elapsed_time_in_milliseconds=1,
        episode=episode,
        trial=1,
        phase=phase,
        completion_percentage=50,
        episode_status="Off track",
        iteration=iteration,
    )


def model(bucket):
    return ModelStore(bucket, "model")


@pytest.fixture
def bucket():
    return Counted()


def put(bucket, name, *records):
    bucket.put(f"{FOLDER}/{name}", encode_metrics(records, "progress"))


def test_all_workers_are_joined_by_iteration_with_evaluations_last(bucket):
    put(
        bucket, "TrainingMetrics.json", record(0, 1), record(0, 1, phase="evaluation"), record(1, 3)
    )
    put(bucket, "TrainingMetrics_1.json", record(0, 2, reward=7.0))
    put(bucket, "EvaluationMetrics-20260102030405.json", record(9, 9))

    assert MetricsReader().read(model(bucket)) == [
        DrivenEpisode(0, 0, 10.0, 50),
        DrivenEpisode(0, 0, 7.0, 50),
        DrivenEpisode(0, 1, 10.0, 50),
        DrivenEpisode(1, 0, 10.0, 50),
    ]


def test_only_objects_that_have_changed_are_read_again(bucket):
    reader = MetricsReader()
    put(bucket, "TrainingMetrics.json", record(0, 1))
    put(bucket, "TrainingMetrics.json.part-000000", record(1, 2))
    first = reader.read(model(bucket))
    assert len(first) == 2
    bucket.read.clear()
    assert reader.read(model(bucket)) is first
    assert bucket.read == []
    put(bucket, "TrainingMetrics.json.part-000000", record(1, 2), record(2, 3))
    assert len(reader.read(model(bucket))) == 3
    assert bucket.read == ["TrainingMetrics.json.part-000000"]


def test_damaged_objects_are_left_out_and_the_others_shown(bucket):
    reader = MetricsReader()
    put(bucket, "TrainingMetrics.json", record(0, 1))
    bucket.put(f"{FOLDER}/TrainingMetrics_1.json", b"{")
    assert len(reader.read(model(bucket))) == 1


def test_a_model_without_episodes_has_none(bucket):
    assert MetricsReader().read(model(bucket)) == []
