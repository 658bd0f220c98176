"""A training as its user meets it: real commands, real worker processes, a real bucket."""

import json
import warnings
from pathlib import Path

import pytest


def test_a_training_ends_by_itself_and_the_communitys_tools_read_all_of_it(
    workspace, trained, log_guru
):
    workspace.put(trained)

    evaluated = workspace.run("evaluate", "--json")

    report = trained.report
    assert report["state"] == "finished"
    assert [worker["restarts"] for worker in report["workers"]] == [0, 0]
    assert [r["episodes"] for r in report["history"]] == [4, 4, 4]
    assert evaluated.returncode == 0, evaluated.stderr
    trials = json.loads(evaluated.stdout.splitlines()[-1])["trials"]
    _assert_deepracer_utils_agrees(workspace.model, report, laps=len(trials))
    reading = log_guru(workspace.log("sim-0"))
    assert (reading.model, len(reading.episodes)) == ("model", 12)
    assert len(reading.evaluations) == sum(
        bool(r["evaluation_progress"]) for r in report["history"]
    )


def _assert_deepracer_utils_agrees(folder: Path, report: dict, laps: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from deepracer.logs import AnalysisUtils, DeepRacerLog

        log = DeepRacerLog(model_folder=str(folder))
        log.load()
        frame = log.dataframe()
        episodes = AnalysisUtils.simulation_agg(frame)
        assert list(episodes["iteration"]) == [0] * 4 + [1] * 4 + [2] * 4
        assert list(episodes["episode"]) == list(range(12))
        metrics = json.loads((folder / "metrics" / "TrainingMetrics.json").read_text())["metrics"]
        training = [r for r in metrics if r["phase"] == "training"]
        assert [round(x) for x in episodes["reward"]] == [r["reward_score"] for r in training]
        for iteration, record in enumerate(report["history"]):
            mean = episodes[episodes["iteration"] == iteration]["reward"].mean()
            assert mean == pytest.approx(record["mean_reward"], rel=1e-6)
        assert log.hyperparameters()["num_episodes_between_training"] == 4
        assert len(log.action_space()) == 3
        assert log.agent_and_network()["network"] == "COMPACT_CONVOLUTIONAL_NETWORK"
        log.load_evaluation_trace(force=True)
        assert set(log.dataframe()["episode"]) == set(range(laps))


@pytest.fixture(scope="module")
def second_start(shared_workspace, trained):
    """What a start over a finished training says, and one with -w that has three workers."""
    shared_workspace.put(trained)
    shared_workspace.hyperparameters["term_cond_max_episodes"] = 2
    shared_workspace.write_custom_files()
    again = shared_workspace.run("start-training")
    shared_workspace.write_run_env(DR_WORKERS=3)
    wiped = shared_workspace.run("start-training", "-w", "--json")
    assert wiped.returncode == 0, wiped.stderr + shared_workspace.logs()
    return again, json.loads(wiped.stdout.splitlines()[-1])["history"]


@pytest.mark.nightly
def test_a_second_start_refuses_to_overwrite_and_names_both_ways_on(second_start):
    again, wiped = second_start

    assert again.returncode == 3
    assert "--resume" in again.stderr
    assert "-w" in again.stderr
    assert [r["iteration"] for r in wiped] == [0, 1]


@pytest.mark.nightly
def test_a_training_that_starts_anew_starts_new_logs_and_keeps_the_old_ones(
    second_start, shared_workspace
):
    for worker in ("sim-0", "trainer", "supervisor"):
        [log] = (shared_workspace.folder / "data" / "logs").rglob(f"{worker}.log")
        [before] = log.parent.glob(f"{worker}.log.2*")
        for path in (log, before):
            starts = path.read_text().count("Successfully downloaded yaml file")
            assert starts == (worker == "sim-0"), path
        copy = shared_workspace.model / "logs" / log.parent.parent.name / log.name
        assert copy.read_bytes() == log.read_bytes()


@pytest.mark.nightly
def test_three_workers_share_episodes_that_do_not_divide_evenly(
    second_start, shared_workspace, log_guru
):
    _, history = second_start

    assert [r["episodes"] for r in history] == [4, 4]
    logs = [log_guru(shared_workspace.log(f"sim-{worker}")) for worker in range(3)]
    assert [len(reading.episodes) for reading in logs] == [4, 2, 2]
    assert [len(reading.evaluations) for reading in logs] == [
        sum(bool(r["evaluation_progress"]) for r in history),
        0,
        0,
    ]
    model = shared_workspace.model
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from deepracer.logs import DeepRacerLog
        from deepracer.logs.metrics import TrainingMetrics

        log = DeepRacerLog(model_folder=str(model))
        log.load()
        traces = log.dataframe()
        metrics = TrainingMetrics("none", region="us-east-1")
        for worker, file in enumerate(
            ["TrainingMetrics", "TrainingMetrics_1", "TrainingMetrics_2"]
        ):
            metrics.addRound("", fname=str(model / "metrics" / f"{file}.json"), worker=worker)
    for worker, share in enumerate([2, 1, 1]):
        mine = traces[traces["worker"] == worker]
        assert [mine[mine["iteration"] == n]["episode"].nunique() for n in range(2)] == [share] * 2
        records = metrics.getTraining()
        records = records[records["worker"] == worker]
        assert [(records["iteration"] == n).sum() for n in range(2)] == [share] * 2
    assert sorted(traces["unique_episode"].unique()) == list(range(8))


@pytest.mark.nightly
def test_a_reward_function_that_fails_later_ends_the_run_with_its_authors_line(workspace):
    workspace.write_custom_files(
        # The trial before the start drives at 1 m/s, the car's actions are faster.
        reward="    return 1.0 if params['speed'] < 1.5 else 1 / 0  # the culprit\n"
    )

    ended = workspace.run("start-training")

    assert ended.returncode == 3
    assert "the culprit" in ended.stderr
    assert "ZeroDivisionError" in ended.stderr
