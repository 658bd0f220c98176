"""`dr evaluate` as its caller meets it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from drcli.base.errors import WorkerDied
from drcli.exchange.evaluation_record import EvaluationRecord
from drcli.exchange.job import Job
from drcli.exchange.policy_source import PolicySource
from drcli.runs.evaluation_plan import EvaluationPlan


@pytest.fixture
def asked(working_folder, evaluation_report, monkeypatch):
    """What the command asks for; the answer is two laps of three."""
    seen = {}

    def evaluate(settings, *, clone, own, opponent, on_progress):
        seen.update(clone=clone, directory=settings.directory, own=own, opponent=opponent)
        on_progress("Evaluating 8_Step-4000.ckpt ...")
        return evaluation_report

    monkeypatch.setattr("drcli.runs.evaluation.evaluate", evaluate)
    return seen


@pytest.mark.parametrize("name", ["evaluate", "start-evaluation"])
def test_an_evaluation_shows_its_trials_under_both_names(dr, asked, working_folder, capsys, name):
    code = dr(name)

    printed = capsys.readouterr()
    assert code == 0
    assert asked == {
        "clone": False,
        "directory": working_folder,
        "own": PolicySource(),
        "opponent": None,
    }
    assert "2 of 3 laps, best 13.42 s, checkpoint 8_Step-4000.ckpt" in printed.out
    assert printed.err.startswith("Evaluating 8_Step-4000.ckpt ...\nNext:\n")


@pytest.mark.parametrize("running", [False, True])
def test_resuming_is_suggested_unless_the_training_runs(
    dr, asked, run, make_report, capsys, running
):
    run.running = running

    dr("evaluate")

    assert ("dr-start-training --resume" in capsys.readouterr().err) is not running


def test_json_is_all_there_is_on_stdout(dr, asked, capsys):
    dr("evaluate", "--json")

    report = json.loads(capsys.readouterr().out)
    assert (report["completed"], report["best_lap_s"]) == (2, 13.4211)
    assert [trial["status"] for trial in report["trials"]] == [
        "Lap complete",
        "Lap complete",
        "Off track",
    ]


def test_quiet_says_nothing_but_the_result(dr, asked, capsys):
    dr("evaluate", "-q")

    printed = capsys.readouterr()
    assert "2 of 3 laps" in printed.out
    assert printed.err == ""


def test_a_copy_is_evaluated_on_request(dr, asked):
    dr("evaluate", "-c")

    assert asked["clone"] is True


def test_files_and_engines_reach_the_evaluation_with_absolute_paths(dr, asked, monkeypatch):
    monkeypatch.chdir(asked.get("directory", "."))

    dr("evaluate", "--model", "a.onnx", "--metadata", "/m.json", "--opponent-runtime", "pb")

    assert asked["own"] == PolicySource(None, Path.cwd() / "a.onnx", Path("/m.json"))
    assert asked["opponent"] == PolicySource("pb")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--runtime", "onxx"), "onxx"),
        (("--metadata", "m.json"), "--metadata belongs to --model"),
        (("--opponent-metadata", "m.json"), "--opponent-metadata belongs to --opponent-model"),
        (("-c", "--model", "a.onnx"), "-c copies a model"),
    ],
)
def test_options_that_make_no_sense_are_refused(dr, asked, capsys, options, why):
    assert dr("evaluate", *options) == 2

    assert why in " ".join(capsys.readouterr().err.split())
    assert asked == {}


def test_the_result_names_file_and_engine(
    dr, working_folder, evaluation_report, monkeypatch, capsys
):
    driven = replace(
        evaluation_report, runtime="openvino", file="/x/policy.pb", checkpoint="policy.pb"
    )
    monkeypatch.setattr("drcli.runs.evaluation.evaluate", lambda *_, **__: driven)

    dr("evaluate")

    printed = " ".join(capsys.readouterr().out.split())
    assert "2 of 3 laps, best 13.42 s, policy.pb with --runtime openvino on" in printed


@pytest.mark.parametrize(
    ("failure", "code"),
    [(WorkerDied("It died.", remedy="Read its log."), 5), (KeyboardInterrupt(), 130)],
)
def test_an_evaluation_that_does_not_end_leaves_stdout_empty(
    dr, working_folder, monkeypatch, capsys, failure, code
):
    def evaluate(*_, **__):
        raise failure

    monkeypatch.setattr("drcli.runs.evaluation.evaluate", evaluate)

    assert dr("evaluate", "--json") == code
    assert capsys.readouterr().out == ""


@pytest.fixture
def launched(working_folder, monkeypatch):
    """What is started in the background; it is nothing."""
    seen = {}

    def prepare(settings, *, clone, own, opponent, on_progress):
        seen["clone"] = clone
        on_progress("Evaluation of model s3://bucket/model starting.")
        job = Job(settings.run, "abc", 7, None, None, settings.directory / "data", 1)
        return EvaluationPlan(job, ["8_Step-4000.ckpt"], "20260102030405")

    def launch(plan):
        seen["stamp"] = plan.stamp
        return EvaluationRecord(
            run_id=0,
            stamp=plan.stamp,
            bucket="bucket",
            prefix="model",
            world="reinvent_base",
            checkpoint=plan.checkpoints[0],
            pid=4242,
            pid_started=0.0,
            worker_pid=4243,
            started_at=0.0,
        )

    monkeypatch.setattr("drcli.runs.evaluation_plan.prepare_evaluation", prepare)
    monkeypatch.setattr("drcli.runs.evaluation.launch_evaluation", launch)
    return seen


def test_the_references_name_with_q_returns_at_once_with_its_line(dr, launched, capsys):
    code = dr("start-evaluation", "-q", "-c")

    printed = capsys.readouterr()
    assert code == 0
    assert launched == {"clone": True, "stamp": "20260102030405"}
    assert printed.out == ""
    assert printed.err == "Evaluation of model s3://bucket/model starting.\n"


def test_an_evaluation_in_the_background_tells_programs_where_results_will_be(dr, launched, capsys):
    dr("start-evaluation", "-q", "--json")

    started = json.loads(capsys.readouterr().out)
    assert started == {
        "prefix": "model",
        "checkpoint": "8_Step-4000.ckpt",
        "pid": 4242,
        "simtrace": "model/evaluation-20260102030405/evaluation-simtrace/0-iteration.csv",
        "metrics": "model/metrics/evaluation/evaluation-20260102030405.json",
    }
