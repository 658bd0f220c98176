"""Reward functions that fail, or declare episodes broken, in the middle of a training (001-17)."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from drcli.model import keys
from drcli.model.growing_file import read_all_metrics
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_reward_errors
from drcli.records.reward import MOST_ERRORS, RewardErrorRecord, sum_of
from drcli.records.trace import read_csv
from drcli.train.rollouts import Collected
from drcli.train.trainer import Trainer
from drcli.workers.reward_failures import (
    SAVED_EVERY_S,
    WINDOW_CALLS,
    AllEpisodesDiscarded,
    RewardErrorsExceeded,
    RewardFailures,
    reward_failure,
)
from drsim.errors import RewardError
from memory_bucket import MemoryBucket
from training_in_memory import PREFIX, TrainingInMemory

SETTINGS = {"reward_on_error": "count", "reward_fallback": 0.5, "reward_max_error_share": 0.05}

SOMETIMES = """
class DiscardEpisode(Exception):
    pass

def reward_function(params):
    if params["steps"] == 4:
        return params["speed"] / params["nothing"]
    if params["steps"] == 6:
        return None
    if params["steps"] == 8 and params["is_left_of_center"]:
        raise DiscardEpisode("the car is lost")
    return 1.0
"""


def failures(worker: int = 0, **changes) -> RewardFailures:
    return RewardFailures(SimpleNamespace(**SETTINGS | changes), worker)


def failure(line: int = 3, kind="raises", cause: Exception | None = None) -> RewardError:
    error = RewardError(
        "The reward function failed.", kind=kind, reason="KeyError: 'x'", line=line, params={"a": 1}
    )
    error.__cause__ = cause or KeyError("x")
    return error


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        (IndexError("list index out of range"), "`waypoints[i % len(waypoints)]`"),
        (IndexError("index 5 is out of bounds for axis 0 with size 5"), "% len(waypoints)"),
        (IndexError("pop from empty list"), "Correct mine.py."),
        (ModuleNotFoundError("none", name="cv2.aruco"), "`pip install opencv-python`"),
        (ModuleNotFoundError("none", name="networkx"), "`pip install networkx`"),
        (KeyError("x"), "Correct mine.py."),
    ],
)
def test_the_commonest_failures_have_a_remedy_of_their_own(cause, words):
    reason = f"{type(cause).__name__}: {cause}"
    error = RewardError("It failed.", kind="raises", reason=reason, file=Path("mine.py"))
    error.__cause__ = cause

    assert words in reward_failure(error).remedy


def test_a_list_of_objects_that_is_empty_has_nothing_to_do_with_waypoints():
    error = RewardError(
        "It failed.",
        kind="raises",
        reason="IndexError: list index out of range",
        source='return params["objects_speed"][0]',
    )

    assert '`if params["objects_location"]:`' in reward_failure(error).remedy


def test_a_counted_failure_gives_the_fallback_and_is_described_once():
    counting = failures()
    counting.begin(4)

    rewards = [counting.handle(failure(), call) for call in (100, 200, 300)]
    counting.handle(failure(line=9), 400)
    counting.count_calls(500)

    assert rewards == [0.5] * 3
    total = counting.record.total
    assert (total.calls, total.failed, total.discarded) == (500, 4, 0)
    assert [(e.line, e.count, e.params) for e in total.errors] == [
        (3, 3, "{'a': 1}"),
        (9, 1, "{'a': 1}"),
    ]


def test_more_than_the_share_of_the_newest_calls_ends_the_run():
    counting = failures()
    counting.begin(0)
    allowed = int(0.05 * WINDOW_CALLS)

    for call in range(1, allowed + 1):
        counting.handle(failure(), call)
    with pytest.raises(RewardErrorsExceeded, match=r"101 of the last 2,000 calls.*KeyError|101"):
        counting.handle(failure(), allowed + 1)


def test_failures_that_are_long_past_do_not_end_the_run():
    counting = failures()
    counting.begin(0)

    for call in range(0, 100 * WINDOW_CALLS, 20):  # five of a hundred, for ever
        counting.handle(failure(), call)

    assert counting.record.total.failed == 10_000


@pytest.mark.parametrize(("share", "survived"), [(0.0, 0), (1.0, WINDOW_CALLS - 1)])
def test_the_share_may_be_nothing_or_all_that_leaves_something_to_learn(share, survived):
    counting = failures(reward_max_error_share=share)
    counting.begin(0)

    rewards = [counting.handle(failure(), call) for call in range(1, survived + 1)]

    assert rewards == [0.5] * survived
    with pytest.raises(RewardErrorsExceeded):
        counting.handle(failure(), survived + 1)


def test_stop_and_a_lack_of_memory_end_the_run_with_the_first_failure():
    for counting, error in (
        (failures(reward_on_error="stop"), failure()),
        (failures(), failure(cause=MemoryError())),
    ):
        counting.begin(0)
        with pytest.raises(RewardError):
            counting.handle(error, 1)


def test_the_newest_discard_is_known_after_many_other_errors():
    counting = failures()
    counting.begin(0)
    for line in range(1, MOST_ERRORS + 1):
        counting.handle(failure(line=line), line)

    counting.handle(failure(line=77, kind="discard"), MOST_ERRORS + 1)

    assert "discard" not in {each.kind for each in counting.record.total.errors}
    assert counting.newest_discard == "line 77: KeyError: 'x'"


def test_calls_of_a_time_without_failures_count_after_a_restart():
    bucket, now_s = MemoryBucket(), [0.0]
    counting = RewardFailures(SimpleNamespace(**SETTINGS), clock=lambda: now_s[0])
    counting.restore(ModelStore(bucket, PREFIX))
    counting.begin(0)
    counting.count_calls(1_000)
    counting.save()
    assert not bucket.list("")  # not with every iteration
    now_s[0] += SAVED_EVERY_S
    counting.save()

    counting = failures()
    counting.restore(ModelStore(bucket, PREFIX))
    counting.begin(1)
    counting.handle(failure(), 1)
    counting.count_calls(1)

    assert (counting.record.total.calls, counting.record.total.failed) == (1_001, 1)


def test_counts_survive_a_kill_and_an_iteration_that_is_driven_again_counts_once():
    bucket = MemoryBucket()
    for iteration in (0, 1, 1, 2):  # killed after iteration 1 was counted
        counting = failures()
        counting.restore(ModelStore(bucket, PREFIX))
        counting.begin(iteration)
        counting.handle(failure(), 10)
        counting.count_calls(10)
        counting.save()

    other = failures(worker=1)
    other.restore(ModelStore(bucket, PREFIX))
    other.begin(0)
    other.handle(failure(), 1)
    other.handle(failure(kind="discard"), 2)
    other.count_calls(20)
    other.save()

    total = sum_of(record.total for record in read_reward_errors(ModelStore(bucket, PREFIX)))
    assert (total.calls, total.failed, total.discarded) == (50, 4, 1)
    assert [(e.kind, e.count, e.first_iteration) for e in total.errors] == [
        ("raises", 4, 0),
        ("discard", 1, 0),
    ]


def test_the_calls_of_another_simulation_are_counted_from_0():
    counting = failures()
    counting.begin(0)
    for call in range(1900, 2000):
        counting.handle(failure(), call)
    counting.count_calls(2000)

    counting.begin_simulation()
    counting.begin(1)
    rewards = [counting.handle(failure(line=9), call) for call in (1, 2)]
    counting.count_calls(30)

    assert rewards == [0.5, 0.5]  # the window has no failures of the simulation before
    assert (counting.record.newest.calls, counting.record.total.calls) == (30, 2030)


def test_damaged_counts_start_over(caplog):
    bucket = MemoryBucket()
    bucket.put(keys.reward_errors(PREFIX, 0), b"[]")
    counting = failures()

    counting.restore(ModelStore(bucket, PREFIX))

    assert counting.record == RewardErrorRecord(0)
    assert read_reward_errors(ModelStore(bucket, PREFIX)) == []


def test_a_training_counts_failures_and_leaves_broken_episodes_out(working_folder, monkeypatch):
    training = TrainingInMemory(
        working_folder,
        monkeypatch,
        DR_TRAIN_MAX_ITERATIONS=2,
        DR_REWARD_ON_ERROR="count",
        DR_REWARD_FALLBACK=0.25,
        DR_REWARD_MAX_ERROR_SHARE=0.5,
        DR_TRAIN_ALTERNATE_DRIVING_DIRECTION=True,
        DR_TRAIN_EVAL_WORLD="willow",
    )
    training.write("custom_files/reward_function.py", SOMETIMES)
    parameters = {"batch_size": 32, "num_epochs": 1, "num_episodes_between_training": 6}
    training.write("custom_files/hyperparameters.json", json.dumps(parameters))

    training.train()

    bucket = training.bucket
    [record] = read_reward_errors(ModelStore(bucket, PREFIX))
    total, history = record.total, read_history(ModelStore(bucket, PREFIX))
    assert {e.kind for e in total.errors} >= {"raises", "type"}
    assert {e.line for e in total.errors if e.kind == "raises"} == {7}
    assert all("speed" in e.params for e in total.errors)
    traced = [e for n in (0, 1) for e in read_csv(bucket.get(keys.training_trace(PREFIX, n)))]
    broken = [e for e in traced if e.status == "discarded"]
    assert broken, "some episode must have been declared broken"
    assert sum(r.discarded for r in history) == len(broken)
    assert sum(r.episodes for r in history) == 12 - len(broken)
    learned = sum(e.steps for e in traced if e.status != "discarded")
    assert sum(r.steps for r in history) == learned
    assert total.failed >= sum(r.reward_errors for r in history) > 0
    metrics = read_all_metrics(bucket, keys.training_metrics(keys.metrics_prefix(PREFIX)))
    marked = [r for r in metrics if r.episode_status == "Discarded" and r.phase == "training"]
    assert len(marked) == len(broken)
    assert history[0].second_world == "willow", "failures are counted on the second track, too"


def test_by_default_a_failure_once_in_a_while_costs_its_step_and_nothing_else(
    working_folder, monkeypatch
):
    training = TrainingInMemory(working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=2)
    training.write(
        "custom_files/reward_function.py",
        "calls = 0\n\n\ndef reward_function(params):\n    global calls\n    calls += 1\n"
        "    return 1.0 / (calls % 300 != 20)\n",
    )

    learned, learn = [], Trainer._learn

    def noted(self: Trainer, collected: Collected) -> None:
        learned.append(collected.rollout)
        learn(self, collected)

    monkeypatch.setattr(Trainer, "_learn", noted)

    training.train()

    unknown = [(~rollout.learned).sum() for rollout in learned]
    counted = [each.reward_errors for each in read_history(ModelStore(training.bucket, PREFIX))]
    assert len(counted) == 2
    assert 0 < sum(unknown) <= sum(counted)  # those of evaluations are counted, too
    assert all((rollout.rewards[~rollout.learned] == 0.001).all() for rollout in learned)


def test_failures_are_counted_in_every_stage(working_folder, monkeypatch):
    training = TrainingInMemory(
        working_folder,
        monkeypatch,
        DR_TRAIN_MAX_ITERATIONS=3,
        DR_REWARD_ON_ERROR="count",
        DR_REWARD_MAX_ERROR_SHARE=0.5,
        DR_CURRICULUM_FILE="curriculum.yaml",
    )
    training.write("custom_files/reward_function.py", SOMETIMES)
    training.write(
        "curriculum.yaml",
        "stages:\n  - name: wide\n    goal: {iterations: 2}\n  - name: narrow\n",
    )

    training.train()

    bucket = training.bucket
    history = read_history(ModelStore(bucket, PREFIX))
    [record] = read_reward_errors(ModelStore(bucket, PREFIX))
    assert [r.stage for r in history] == ["wide", "wide", "narrow"]
    assert all(r.reward_errors > 0 for r in history)
    driven = sum(r.steps for r in history)
    assert record.before.calls + record.newest.calls >= driven
    assert record.newest.calls >= history[-1].steps


def test_a_function_that_breaks_every_episode_ends_the_training(working_folder, monkeypatch):
    training = TrainingInMemory(working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=2)
    training.write(
        "custom_files/reward_function.py",
        "from drsim import DiscardEpisode\n\n\ndef reward_function(params):\n"
        "    raise DiscardEpisode('no good')\n",
    )

    with pytest.raises(AllEpisodesDiscarded, match=r"all 2 episodes of iteration 0 broken.*line 5"):
        training.train()

    assert read_history(ModelStore(training.bucket, PREFIX)) == []
