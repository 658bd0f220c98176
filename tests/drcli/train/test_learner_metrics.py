"""metrics/learner.csv: readable in one line, whole after a resume, and never a reason to stop."""

import csv
import io
import math

import pytest

from drcli.base.errors import StorageError
from drcli.learn.update_result import PPOStats, SACStats
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.train.learner_metrics import LearnerMetrics, line_of, row_of
from memory_bucket import MemoryBucket

KEY = keys.learner_metrics("model")

PPO_STATS = PPOStats(2, 0.001, -0.01, 0.2, 1.5, 0.004, 0.125, explained_variance=0.75)

SAC_STATS = SACStats(3, 0.0003, -2.0, 10.0, 11.0, 0.5, 0.25, 0.9, 0.2, math.nan)


@pytest.fixture
def bucket():
    return MemoryBucket()


def table(bucket) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(bucket.get(KEY).decode())))


def written(bucket, *rows) -> None:
    metrics = LearnerMetrics(ModelStore(bucket, "model"))
    for row in rows:
        metrics.add(row)


def test_an_iteration_of_ppo_has_the_names_that_cleanrl_gives(bucket, make_record):
    written(bucket, row_of(make_record(4), PPO_STATS))

    [row] = table(bucket)
    assert row == {
        "iteration": "4",
        "global_step": "2500",
        "charts/episodic_return": "26",
        "charts/episodic_length": "25",
        "charts/SPS": "357.143",
        "charts/learning_rate": "0.001",
        "losses/value_loss": "0.2",
        "losses/policy_loss": "-0.01",
        "losses/entropy": "1.5",
        "losses/approx_kl": "0.004",
        "losses/clipfrac": "0.125",
        "losses/explained_variance": "0.75",
    }


def test_an_iteration_of_sac_has_its_own_losses_and_no_divergence(bucket, make_record):
    unknown = dict.fromkeys(("surrogate_loss", "value_loss", "kl"), math.nan)
    record = make_record(4, **unknown, entropy=0.9, actor_loss=-2.0, critic_loss=0.375, alpha=0.2)

    written(bucket, row_of(record, SAC_STATS))

    [row] = table(bucket)
    assert {name: text for name, text in row.items() if name.startswith("losses/")} == {
        "losses/qf1_values": "10",
        "losses/qf2_values": "11",
        "losses/qf1_loss": "0.5",
        "losses/qf2_loss": "0.25",
        "losses/qf_loss": "0.375",
        "losses/actor_loss": "-2",
        "losses/entropy": "0.9",
        "losses/alpha": "0.2",
    }


def test_the_log_has_an_iteration_in_one_line(make_record):
    line = line_of(row_of(make_record(4), PPO_STATS))

    assert line.startswith("Metrics> iteration=4 global_step=2500 charts/episodic_return=26 ")
    assert "losses/explained_variance=0.75" in line
    assert "\n" not in line


def test_before_anything_is_learned_the_losses_are_empty(bucket, make_record):
    unknown = dict.fromkeys(("surrogate_loss", "value_loss", "kl", "entropy"), math.nan)

    written(bucket, row_of(make_record(0, **unknown)), row_of(make_record(1), PPO_STATS))

    first, second = table(bucket)
    assert (first["losses/entropy"], second["losses/entropy"]) == ("", "1.5")


def test_a_resumed_training_goes_on_with_the_rows_that_still_count(bucket, make_record):
    written(bucket, *(row_of(make_record(n), PPO_STATS) for n in range(4)))

    metrics = LearnerMetrics(ModelStore(bucket, "model"))
    problem = metrics.restore([make_record(0), make_record(1)])
    metrics.add(row_of(make_record(2), PPO_STATS))
    metrics.finish()

    assert problem is None
    rows = table(bucket)
    assert [row["iteration"] for row in rows] == ["0", "1", "2"]
    assert {row["losses/clipfrac"] for row in rows} == {"0.125"}


def test_what_the_file_lacks_comes_from_the_history(bucket, make_record):
    written(bucket, row_of(make_record(1), PPO_STATS))

    metrics = LearnerMetrics(ModelStore(bucket, "model"))
    metrics.restore([make_record(0), make_record(1)])
    metrics.finish()

    first, second = table(bucket)
    assert (first["losses/value_loss"], first["losses/clipfrac"]) == ("0.45", "")
    assert (second["losses/value_loss"], second["losses/clipfrac"]) == ("0.2", "0.125")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"{}",
        b"name,age\nAda,36\n",
        b"iteration\n1\n",
        b"\x00",
        b'"',
        b"a" * 200_000,
    ],
    ids=["empty", "bytes", "json", "others", "half", "null", "quote", "long"],
)
def test_a_file_of_something_else_is_written_anew_and_said(bucket, make_record, content):
    bucket.put(KEY, content)

    metrics = LearnerMetrics(ModelStore(bucket, "model"))
    problem = metrics.restore([make_record(0)])
    metrics.finish()

    assert KEY in problem
    assert [row["iteration"] for row in table(bucket)] == ["0"]


def test_damaged_cells_are_left_out(bucket, make_record):
    text = "iteration,global_step,losses/entropy,mine\n0,x,2.5,7\n1,2,nan\nx,1,1,1\n1,2,3,4,5,6\n"
    text += f"{'1' * 400},5\n1,{'2' * 400}\n1,2,3\n"
    bucket.put(KEY, text.encode())

    metrics = LearnerMetrics(ModelStore(bucket, "model"))
    assert metrics.restore([make_record(0), make_record(1)]) is None
    metrics.finish()

    rows = table(bucket)
    assert [row["losses/entropy"] for row in rows] == ["2.5", "3"]
    assert [row["global_step"] for row in rows] == ["500", "2"]
    assert "mine" not in rows[0]


def test_a_bucket_that_does_not_answer_is_a_line_in_the_log(bucket, make_record, logged):
    def refuse(key, data):
        raise StorageError("Nothing answers.", remedy="Wait.")

    bucket.put = refuse

    written(bucket, row_of(make_record(0), PPO_STATS))

    assert "was not written: Nothing answers." in logged()
