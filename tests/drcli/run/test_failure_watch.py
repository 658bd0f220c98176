"""Journal and status of a training that goes on after failures."""

from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.training_state import Rollback, Rollbacks, write_rollbacks
from drcli.records.reward import RewardCounts, RewardErrorEntry, RewardErrorRecord
from drcli.run.watches import FailureWatch
from watched_run import WatchedRun

BACK = Rollback(
    1.0, "collapse", "Completion fell", "9_Step-9.ckpt", "4_Step-4.ckpt", 0.003, 1 / 3, 60.0
)


def put_errors(bucket, worker: int, *lines: int) -> None:
    entries = [
        RewardErrorEntry("raises", "KeyError", "KeyError: 'x'", line, "y = p['x']", "{'a': 1}", 3)
        for line in lines
    ]
    counts = RewardCounts(100, 3 * len(lines), 1, entries)
    record = RewardErrorRecord(worker, 2, newest=counts)
    bucket.put(keys.reward_errors("model", worker), record.encode())


def test_each_distinct_error_and_rollback_is_told_once(tmp_path):
    run = WatchedRun(tmp_path, workers=2)
    bucket = run.running.bucket

    def begun() -> FailureWatch:
        watch = FailureWatch(run.running)
        watch.start()
        return watch

    def look(watch: FailureWatch) -> None:
        watch.work()
        watch.check()

    watch = begun()
    look(watch)
    assert run.told == []

    put_errors(bucket, 0, 12)
    put_errors(bucket, 1, 12, 40)
    write_rollbacks(ModelStore(bucket, "model"), Rollbacks([BACK]))
    look(watch)
    look(watch)

    assert run.told == [
        "Completion fell. Went back from checkpoint 9 to 4 with a learning rate of 0.001.",
        "The reward function failed, and the training goes on (sim-0, iteration 0): "
        "line 12: KeyError: 'x'.",
        "The reward function failed, and the training goes on (sim-1, iteration 0): "
        "line 40: KeyError: 'x'.",
        "9 of 200 calls of the reward function failed (4.5 %); nothing was learned from these "
        "steps (DR_REWARD_MAX_ERROR_SHARE=0.05 of the last 2,000 calls ends the training).",
    ]
    assert watch.end_facts() == {"rollbacks": 1, "reward_errors": 9, "discarded_episodes": 2}

    resumed = begun()
    put_errors(bucket, 1, 12, 40, 55)
    assert resumed.end_facts()["reward_errors"] == 12
    assert [text for text in run.told if "line 55" in text] == [run.told[-1]]
    assert len(run.told) == 5
