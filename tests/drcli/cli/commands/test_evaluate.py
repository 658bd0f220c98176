"""`dr evaluate` as its caller meets it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from drcli.base.errors import WorkerDied
from drcli.exchange.evaluation_record import EvaluationRecord
from drcli.exchange.job import Job
from drcli.exchange.policy_source import PolicySource
from drcli.exchange.robust_result import RobustCell, RobustResult
from drcli.runs.evaluation_loop import BestLap, LoopReport
from drcli.runs.evaluation_plan import EvaluationPlan
from drcli.runs.many_evaluations import BestStart, TableReport, TableRow

SETTINGS = {}
"""What the last evaluation was asked to drive with."""


@pytest.fixture
def asked(working_folder, evaluation_report, monkeypatch):
    """What the command asks for; the answer is two laps of three."""
    seen, settings_seen = {}, SETTINGS
    settings_seen.clear()

    def evaluate(settings, *, clone, seed, own, opponent, on_progress):
        seen.update(clone=clone, directory=settings.directory, own=own, opponent=opponent)
        settings_seen.update(settings=settings, seed=seed)
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

    dr("evaluate", "--model", "a.onnx", "--metadata", "/m.json", "--opp-runtime", "pb")

    assert asked["own"] == PolicySource(None, Path.cwd() / "a.onnx", Path("/m.json"))
    assert asked["opponent"] == PolicySource("pb")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--runtime", "onxx"), "onxx"),
        (("--metadata", "m.json"), "--metadata belongs to --model"),
        (("--opp-metadata", "m.json"), "--opp-metadata belongs to --opp-model"),
        (("-c", "--model", "a.onnx"), "-c copies a model"),
        (("--loop", "--robust"), "--loop drives one model on one track"),
        (("--loop", "--model", "a.onnx"), "--loop follows a model in the bucket"),
        (("-c", "--models", "a*"), "-c copies a model for a single evaluation"),
        (("--robust", "--opp-runtime", "pb"), "An opponent drives in a single evaluation"),
        (("--models", "a", "--model", "a.onnx"), "--models names models in the bucket"),
        (("--models", ", "), "--models is empty"),
        (("--start", "outside"), "neither one of left, centre, right nor a number of metres"),
        (("--start-angle", "200"), "--start-angle 200 is above 180. Set --start-angle to a number"),
        (("--worlds", ","), "--worlds is empty"),
        (("--average-laps", "0"), "is below 1"),
    ],
)
def test_options_that_make_no_sense_are_refused(dr, asked, capsys, options, why):
    assert dr("evaluate", *options) == 2

    assert why in " ".join(capsys.readouterr().err.split())
    assert asked == {}


def test_flags_change_the_settings_of_one_evaluation_only(dr, asked, working_folder):
    """003-12 and 003-18: start, direction, cap and average of this evaluation."""
    given = "--start LEFT --start-angle -15 --start-position 0.25 --reverse --max-lap-seconds 1200"

    dr("evaluate", *given.split(), "--average-laps", "2", "--seed", "9")

    driven = SETTINGS["settings"]
    assert SETTINGS["seed"] == 9
    assert (driven.eval_start_offset, driven.eval_start_angle) == ("left", -15.0)
    assert (driven.eval_start_position, driven.eval_reverse_direction) == (0.25, True)
    assert (driven.eval_max_lap_seconds, driven.eval_average_laps) == (1200.0, 2)
    assert driven.source("DR_EVAL_START_ANGLE") == "flag"
    assert "DR_EVAL" not in (working_folder / "run.env").read_text()


def test_a_start_that_had_to_be_moved_is_said(dr, asked, evaluation_report, monkeypatch, capsys):
    moved = replace(evaluation_report, notes=["The car starts 0.30 m to the left."])
    monkeypatch.setattr("drcli.runs.evaluation.evaluate", lambda *_, **__: moved)

    dr("evaluate", "--start", "5")

    assert "0.30 m to the left" in capsys.readouterr().err


def test_the_best_average_counts_completed_laps_in_a_row_only(evaluation_report):
    """003-12: worked by hand from laps of 13.4211, 15 and an unfinished one."""
    assert evaluation_report.best_average_s is None
    assert replace(evaluation_report, average_laps=2).best_average_s == pytest.approx(14.21055)
    assert replace(evaluation_report, average_laps=1).best_average_s == 13.4211


def test_the_average_is_shown_beside_the_best_lap(
    dr, working_folder, evaluation_report, monkeypatch, capsys
):
    report = replace(evaluation_report, average_laps=2)
    monkeypatch.setattr("drcli.runs.evaluation.evaluate", lambda *_, **__: report)

    dr("evaluate")

    printed = " ".join(capsys.readouterr().out.split())
    assert "best 13.42 s, best average of 2 laps 14.21 s, checkpoint" in printed


def row(prefix, world="reinvent_base", **fields):
    return TableRow(prefix, f"{prefix}.ckpt", world, **fields)


TABLE = TableReport(
    rows=[
        row("fast", completed=3, trials=3, progress=100.0, best_lap_s=9.5, best_average_s=9.75),
        row("broken", reason="model/0.ckpt is damaged.", remedy="Restore it."),
    ],
    best=[BestStart("reinvent_base", "fast", "fast.ckpt", "DR_WORLD_NAME=x dr-start-training")],
    table="comparisons/comparison-20260102030405.json",
)


@pytest.fixture
def many(working_folder, monkeypatch):
    """What several evaluations are asked for; the answer can be replaced."""
    seen = {"report": TABLE}

    def prepare(settings, **asked):
        seen.update(asked)
        return "plan"

    monkeypatch.setattr("drcli.runs.many_evaluations_plan.prepare_many", prepare)
    monkeypatch.setattr("drcli.runs.many_evaluations.run_many", lambda *_: seen["report"])
    return seen


def test_models_and_worlds_give_a_table_and_the_command_that_goes_on(dr, many, capsys):
    code = dr("evaluate", "--models", "team/*, other", "--worlds", "reinvent_base,Oval_track")

    printed = " ".join(capsys.readouterr().out.split())
    assert code == 0
    assert many["models"] == ["team/*", "other"]
    assert many["worlds"] == ["reinvent_base", "Oval_track"]
    assert many["robust"] is False
    assert "reinvent_base fast fast.ckpt 3/3 100 % 9.50 s 9.75 s" in printed
    assert "reinvent_base broken model/0.ckpt is damaged." in printed
    assert "Best on reinvent_base: fast." in printed
    assert "DR_WORLD_NAME=x dr-start-training" in printed


def test_a_table_without_any_result_is_printed_and_fails(dr, many, capsys):
    many["report"] = replace(TABLE, rows=TABLE.rows[1:], best=[])

    code = dr("evaluate", "--models", "*", "--json")

    printed = capsys.readouterr()
    assert code == 5
    assert json.loads(printed.out)["rows"][0]["reason"] == "model/0.ckpt is damaged."
    assert "None of these models could be evaluated." in printed.err


CELLS = [
    RobustCell("none", "none", 4, 4, 100.0, 13.2),
    RobustCell("latency", "0.1 s", 4, 0, 20.0, None, "Off track"),
]


def test_a_grid_is_shown_with_what_broke_the_model_and_its_score(dr, many, capsys):
    found = RobustResult("model", "8.ckpt", "reinvent_base", 3, CELLS, 9.0)
    scored = row("model", robust_score=found.robust_score, trials=8, completed=4)
    many["report"] = replace(TABLE, rows=[scored], robust=[found])

    dr("evaluate", "--robust", "--seed", "3")

    printed = " ".join(capsys.readouterr().out.split())
    assert (many["robust"], many["seed"]) == (True, 3)
    assert "latency 0.1 s 0/4 20 % Off track 20.0" in printed
    assert "Broken by: latency 0.1 s. Robust score 60.0 of 100" in printed


def test_the_json_of_a_grid_has_cells_and_score(dr, many, capsys):
    found = RobustResult("model", "8.ckpt", "reinvent_base", 3, CELLS, 9.0)
    scored = row("model", robust_score=found.robust_score)
    many["report"] = replace(TABLE, rows=[scored], robust=[found])

    dr("evaluate", "--robust", "--json")

    printed = json.loads(capsys.readouterr().out)
    assert printed["robust_score"] == 60.0
    assert printed["axis_scores"] == {"none": 100.0, "latency": 20.0}
    assert printed["cells"][1]["ended_by"] == "Off track"


def test_a_loop_ends_with_its_table(dr, working_folder, monkeypatch, capsys):
    lap = BestLap("reinvent_base", "8.ckpt", 9.5, None, 2, 3, "2026-01-02T03:04:05", "2" * 14)

    def loop(settings, *, seed, on_progress, on_failure):
        on_failure("The bucket does not answer. The loop goes on.")
        return LoopReport("model", settings.world_name, 2, 1, [lap], "model/metrics/best-laps.json")

    monkeypatch.setattr("drcli.runs.evaluation_loop.run_loop", loop)

    code = dr("evaluate", "--loop")

    printed = capsys.readouterr()
    assert code == 0
    assert "9.50 s" in printed.out
    assert "2 rounds, 1 failed of model on reinvent_base." in printed.out
    assert "The loop goes on." in printed.err


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

    def prepare(settings, *, clone, seed, own, opponent, on_progress):
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
