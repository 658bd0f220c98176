import json
import warnings
from dataclasses import replace
from pathlib import Path

import pytest

from drcli.model import growing_file, keys
from drcli.model.growing_file import list_parts, read_all_metrics
from drcli.model.model_store import ModelStore
from drcli.model.repair import repair_metrics
from drcli.records.episode_metrics import EpisodeMetrics, encode_metrics
from drcli.records.trace import Episode, Row, csv_text, schedule
from drcli.train.drive_results import TrainingMetrics
from drcli.train.episode_share import Share
from memory_bucket import MemoryBucket

PREFIX = "model/metrics"
KEY = keys.training_metrics(PREFIX, 0)
TWO_EPISODES = Share(0, workers=1, episodes=2)


@pytest.fixture
def bucket() -> MemoryBucket:
    return MemoryBucket()


def test_trials_restart_each_iteration_and_evaluations_repeat_the_last_episode(bucket):
    metrics = TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES)

    for iteration in range(2):
        first = 2 * iteration
        metrics.add(iteration, [_episode(first), _episode(first + 1)])
        metrics.add(iteration, [], [_episode(0, "evaluation")])

    records = json.loads(bucket.get(KEY))["metrics"]
    assert [(r["phase"], r["episode"], r["trial"]) for r in records] == [
        ("training", 1, 1),
        ("training", 2, 2),
        ("evaluation", 2, 2),
        ("training", 3, 1),
        ("training", 4, 2),
        ("evaluation", 4, 2),
    ]


def test_a_restarted_worker_continues_the_file_and_forgets_the_iteration_it_repeats(bucket):
    first = TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES)
    first.add(0, [_episode(0), _episode(1)])
    first.add(0, [], [_episode(0, "evaluation")])
    first.add(1, [_episode(2), _episode(3)])

    second = TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES)
    second.keep_before(1)
    second.add(1, [_episode(2), _episode(3)])

    records = json.loads(bucket.get(KEY))["metrics"]
    assert [r["episode"] for r in records] == [1, 2, 2, 3, 4]


def test_the_clock_goes_on_after_the_last_record(bucket):
    metrics = TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES)
    metrics.add(0, [_episode(0)])

    assert TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES).clock_s == pytest.approx(1.0)


def test_episodes_that_do_not_divide_evenly_are_found_in_their_iterations(bucket, tmp_path):
    for iteration in range(4):
        for worker in range(3):
            if (worker, iteration) != (2, 1):  # which was late
                _drive(bucket, Share(worker, workers=3, episodes=20), iteration)

    found = _episodes_of_iterations(bucket, tmp_path, workers=3)

    assert found[0] == [7, 7, 7, 7]
    assert found[1] == [7, 7, 7, 7]
    assert found[2] == [6, 0, 6, 6]


def test_a_resume_with_more_or_fewer_episodes_leaves_the_iterations_before_it(bucket, tmp_path):
    for iteration, episodes in enumerate([8, 8, 20, 20, 5]):
        for worker in range(3):
            _drive(bucket, Share(worker, workers=3, episodes=episodes), iteration)

    found = _episodes_of_iterations(bucket, tmp_path, workers=3)

    assert found == {0: [3, 3, 7, 7, 2], 1: [3, 3, 7, 7, 2], 2: [2, 2, 6, 6, 1]}


def test_an_iteration_that_is_driven_again_after_a_resume_replaces_the_first(bucket, tmp_path):
    for iteration in (0, 1, 2, 1, 2):
        _drive(bucket, Share(0, workers=1, episodes=3), iteration)

    assert _episodes_of_iterations(bucket, tmp_path, workers=1) == {0: [3, 3, 3]}


def test_a_file_of_version_0_1_0_gets_the_numbers_that_tools_count_with(bucket):
    share = Share(2, workers=3, episodes=5)  # one episode beside the two of worker 0
    record = EpisodeMetrics.of(_episode(0), iteration=0, episode=1, trial=1)
    record = replace(record, iteration=None)
    old = {"metrics": [record.to_json(), replace(record, episode=2).to_json()]}
    key = keys.training_metrics(PREFIX, 2)
    bucket.put(key, json.dumps(old).encode())

    metrics = TrainingMetrics(ModelStore(bucket, "model"), share)
    metrics.add(2, [_episode(2)])

    records = json.loads(bucket.get(key))["metrics"]
    assert [r["episode"] for r in records] == [1, 3, 5]


def dying(bucket: MemoryBucket, at_write: int) -> MemoryBucket:
    """The bucket as a process sees it that is killed just before its n-th write.

    None of its threads writes anything afterwards.
    """
    writes = 0

    def check(_key: str) -> None:
        nonlocal writes
        writes += 1
        if writes >= at_write:
            raise KeyboardInterrupt

    return bucket.fenced(check)


def _train(bucket: MemoryBucket, first: int) -> int:
    """A worker from one iteration to the end of the training; returns where it was killed."""
    iteration = first
    try:
        metrics = TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES)
        for iteration in range(first, 40):
            metrics.keep_before(iteration)
            metrics.add(iteration, [_episode(2 * iteration), _episode(2 * iteration + 1)])
            if iteration % 3 == 0:
                metrics.add(iteration, [], [_episode(0, "evaluation")])
        metrics.finish()
    except KeyboardInterrupt:
        return iteration
    return 40


@pytest.fixture(params=[0, 20_000], ids=["parts at once", "parts later"])
def in_parts(request, monkeypatch):
    monkeypatch.setattr(growing_file, "SMALL_BYTES", request.param)
    monkeypatch.setattr(growing_file, "WHOLE_EVERY_S", 0.0)


@pytest.mark.usefixtures("in_parts")
@pytest.mark.parametrize("first", [1, 2, 3])
def test_whenever_a_worker_is_killed_no_episode_is_lost_or_doubled(first):
    undisturbed = MemoryBucket()
    assert _train(undisturbed, 0) == 40
    assert list_parts(undisturbed, KEY) == []

    at_write = first
    killed_at = 0
    while killed_at < 40:
        bucket = MemoryBucket()
        killed_at = _train(dying(bucket, at_write), 0)
        at_write += 3
        if killed_at < 40:
            known = {r.iteration for r in read_all_metrics(bucket, KEY)}
            assert known >= set(range(killed_at))
        _train(bucket, min(killed_at, 39))

        assert bucket.get(KEY) == undisturbed.get(KEY)
        assert list_parts(bucket, KEY) == []


@pytest.mark.usefixtures("in_parts")
def test_a_damaged_part_is_set_aside_and_its_training_episodes_come_from_the_traces(bucket):
    metrics = TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES)
    for iteration in range(40):
        episodes = [_episode(2 * iteration), _episode(2 * iteration + 1)]
        for episode in episodes:
            episode.rows.insert(0, replace(episode.rows[0], done=False, time_s=0.0))
        schedule(episodes, metrics.clock_s)
        trace = csv_text(episodes, (1.0, 2.0)).encode()
        bucket.put(keys.training_trace("model", iteration), trace)
        metrics.add(iteration, episodes)
    expected = read_all_metrics(bucket, KEY)
    metrics.finish()
    damaged = keys.part(KEY, 2)
    lost = {"metrics": [r.to_json() for r in expected if r.iteration >= 35]}
    kept = [r for r in expected if r.iteration < 35]
    bucket.put(KEY, encode_metrics(kept, "progress"))
    bucket.put(damaged, json.dumps(lost).encode()[:-100])

    [sentence] = repair_metrics(ModelStore(bucket, "model", PREFIX))

    assert damaged in sentence
    assert [(r.iteration, r.trial, r.reward_score) for r in read_all_metrics(bucket, KEY)] == [
        (r.iteration, r.trial, r.reward_score) for r in expected
    ]


def _drive(bucket: MemoryBucket, share: Share, iteration: int) -> None:
    """One iteration of a worker that was started for it."""
    metrics = TrainingMetrics(ModelStore(bucket, "model"), share)
    metrics.keep_before(iteration)
    metrics.add(iteration, [_episode(number) for number in share.numbers(iteration)])
    if share.worker == 0:
        metrics.add(iteration, [], [_episode(0, "evaluation")])


def _episodes_of_iterations(
    bucket: MemoryBucket, folder: Path, workers: int
) -> dict[int, list[int]]:
    """Training episodes of each iteration by worker, as deepracer-utils counts them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from deepracer.logs.metrics import TrainingMetrics as Reader

        reader = Reader("none", region="us-east-1")
        for worker in range(workers):
            file = folder / f"{worker}.json"
            file.write_bytes(bucket.get(keys.training_metrics(PREFIX, worker)))
            reader.addRound("model", fname=str(file), worker=worker)
    episodes = reader.getTraining()
    evaluations = reader.getEvaluation()
    assert sorted(evaluations["iteration"]) == sorted(set(episodes["iteration"]))
    last = episodes["iteration"].max()
    return {
        worker: [
            int(((episodes["worker"] == worker) & (episodes["iteration"] == iteration)).sum())
            for iteration in range(last + 1)
        ]
        for worker in range(workers)
    }


def _episode(number: int, phase: str = "training") -> Episode:
    row = Row(1, 0.0, 0.0, 0.0, 0.0, 1.0, "0", 0.0, True, True, 50.0, 0, "off_track", 0.0, 1.0)
    return Episode(number, phase, [row])


def test_a_file_of_version_0_1_0_keeps_its_iterations_when_their_episodes_change(bucket):
    metrics = TrainingMetrics(ModelStore(bucket, "model"), TWO_EPISODES)
    for iteration in range(2):
        metrics.add(iteration, [_episode(2 * iteration), _episode(2 * iteration + 1)])
    file = json.loads(bucket.get(KEY))
    for record in file["metrics"]:
        del record["iteration"]
    bucket.put(KEY, json.dumps(file).encode())

    resumed = TrainingMetrics(ModelStore(bucket, "model"), Share(0, workers=1, episodes=4))
    resumed.add(2, [_episode(number) for number in range(4, 8)])

    records = json.loads(bucket.get(KEY))["metrics"]
    assert [r["iteration"] for r in records] == [0, 0, 1, 1, 2, 2, 2, 2]
    assert [r["episode"] for r in records] == [1, 2, 5, 6, 9, 10, 11, 12]


def test_a_worker_that_comes_along_later_numbers_its_episodes_as_worker_0_does(bucket):
    alone = TrainingMetrics(ModelStore(bucket, "model"), Share(0, workers=1, episodes=4))
    for iteration in range(2):
        alone.add(iteration, [_episode(4 * iteration + k) for k in range(4)])

    joined = TrainingMetrics(ModelStore(bucket, "model"), Share(1, workers=2, episodes=4))
    joined.add(2, [_episode(4), _episode(5)])

    assert [
        r["episode"] for r in json.loads(bucket.get(f"{PREFIX}/TrainingMetrics_1.json"))["metrics"]
    ] == [9, 10]
