"""`dr evaluate` as its caller meets it."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from drcli.base.errors import WorkerDied
from drcli.records.evaluation_task import PolicySource, RobustCell, RobustResult
from drcli.records.job import Job
from drcli.records.run_record import EvaluationRecord
from drcli.run.evaluation_loop import BestLap, LoopReport
from drcli.run.evaluation_plan import EvaluationPlan
from drcli.run.evaluation_report import TrialReport, compare, laps_report
from drcli.run.many_evaluations import BestStart, Rival, TableReport, TableRow

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

    monkeypatch.setattr("drcli.run.evaluation.evaluate", evaluate)
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
    assert "1 of 3 laps clean (1 reset), 2 finished, best 13.42 s; checkpoint" in printed.out
    assert printed.err.startswith("Evaluating 8_Step-4000.ckpt ...\nNext:\n")


@pytest.mark.parametrize("running", [False, True])
def test_resuming_is_suggested_unless_the_training_runs(
    dr, asked, run, make_report, capsys, running
):
    run.running = running

    dr("evaluate")

    assert ("dr-start-training --resume" in capsys.readouterr().err) is not running


@pytest.mark.parametrize(
    ("race_type", "options", "command"),
    [
        ("TIME_TRIAL", (), "dr-evaluate --laps 40"),
        (
            "TIME_TRIAL",
            ("--checkpoint", "3", "--runtime", "onnx"),
            "dr-evaluate --checkpoint 3 --runtime onnx --laps 40",
        ),
        ("TIME_TRIAL", ("--model", "a.onnx"), None),
        ("HEAD_TO_MODEL", (), None),
    ],
)
def test_more_laps_are_suggested_with_what_was_evaluated(
    dr, asked, monkeypatch, capsys, race_type, options, command
):
    monkeypatch.setenv("DR_RACE_TYPE", race_type)

    assert dr("evaluate", *options) == 0

    printed = capsys.readouterr().err
    laps = [line.strip() for line in printed.splitlines() if "--laps" in line]
    assert laps == ([command] if command else [])


def test_json_is_all_there_is_on_stdout(dr, asked, capsys):
    dr("evaluate", "--json")

    report = json.loads(capsys.readouterr().out)
    assert (report["completed"], report["best_lap_s"]) == (2, 13.4211)
    assert (report["clean"], report["resets"]) == (1, 1)
    assert [trial["clean"] for trial in report["trials"]] == [True, False, False]
    assert [trial["status"] for trial in report["trials"]] == [
        "Lap complete",
        "Lap complete",
        "Off track",
    ]


def test_quiet_says_nothing_but_the_result(dr, asked, capsys):
    dr("evaluate", "-q")

    printed = capsys.readouterr()
    assert "1 of 3 laps clean" in printed.out
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
        (("--laps", "0"), "must be at least 1"),
        (("--laps", "5", "--loop"), "--loop drives one model on one track"),
        (("--laps", "5", "--start", "left", "--robust"), "leave out --start, --robust"),
        (("--laps", "5", "--video"), "--video films a single evaluation"),
        (("--laps", "5", "-c"), "-c copies a model"),
        (("--against", "best"), "write --laps 40 with it"),
        (("--laps", "5", "--models", "a", "--against", "b"), "no --models or --worlds"),
        (("--laps", "5", "--against", "a:nix"), "--against a:nix is neither the number"),
        (("--laps", "5", "--against", "/"), "--against / names neither a checkpoint nor a model"),
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


def test_a_start_keeps_every_digit_so_that_a_lap_can_be_driven_again(dr, asked):
    dr("evaluate", "--start", "-0.0472592937135556", "--start-position", "0.0981413752986491")

    driven = SETTINGS["settings"]
    assert float(driven.eval_start_offset) == -0.0472592937135556
    assert driven.eval_start_position == 0.0981413752986491


def test_a_start_that_had_to_be_moved_is_said(dr, asked, evaluation_report, monkeypatch, capsys):
    moved = replace(evaluation_report, notes=["The car starts 0.30 m to the left."])
    monkeypatch.setattr("drcli.run.evaluation.evaluate", lambda *_, **__: moved)

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
    monkeypatch.setattr("drcli.run.evaluation.evaluate", lambda *_, **__: report)

    dr("evaluate")

    printed = " ".join(capsys.readouterr().out.split())
    assert "best 13.42 s, best average of 2 laps 14.21 s with 1 reset; checkpoint" in printed


def test_a_lap_with_resets_is_never_the_best_and_its_time_has_its_penalty(
    dr, working_folder, evaluation_report, monkeypatch, capsys
):
    trials = [
        TrialReport(n, 100.0, time_s, "Lap complete", 9, 0, 9, 45.0)
        for n, time_s in enumerate((59.87, 61.0, 60.2), start=1)
    ]
    report = replace(evaluation_report, trials=trials)
    monkeypatch.setattr("drcli.run.evaluation.evaluate", lambda *_, **__: report)

    dr("evaluate")
    shown = capsys.readouterr().out
    dr("evaluate", "--json")

    printed = " ".join(shown.split())
    assert (
        "0 of 3 laps clean (27 resets), 3 finished, the fastest in 59.87 s = 14.87 driven + 45.00 "
        "penalty, 9 resets, best average of 3 laps 60.36 s with 27 resets; checkpoint"
    ) in printed
    assert "1 100 % 59.87 s 14.87 s 45.00 s finished 9 9" in printed
    assert max(map(len, shown.splitlines()[:4])) <= 80
    told = json.loads(capsys.readouterr().out)
    assert (told["best_lap_s"], told["best_finished_s"], told["completed"]) == (None, 59.87, 3)


def row(prefix, *figures, world="reinvent_base", **fields):
    return TableRow(prefix, f"{prefix}.ckpt", world, *figures, **fields)


TABLE = TableReport(
    rows=[
        row("fast", 3, 3, 100.0, 9.5, 9.75, clean=3, median_s=9.6),
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

    monkeypatch.setattr("drcli.run.many_evaluations.prepare_many", prepare)
    monkeypatch.setattr("drcli.run.many_evaluations.run_many", lambda *_: seen["report"])
    return seen


def test_models_and_worlds_give_a_table_and_the_command_that_goes_on(dr, many, capsys):
    code = dr("evaluate", "--models", "team/*, other", "--worlds", "reinvent_base,Oval_track")

    printed = " ".join(capsys.readouterr().out.split())
    assert code == 0
    assert many["models"] == ["team/*", "other"]
    assert many["worlds"] == ["reinvent_base", "Oval_track"]
    assert many["robust"] is False
    assert "reinvent_base fast fast.ckpt 3/3 0 100 % 9.60 s 9.50 s 9.75 s" in printed
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


def sample(prefix, *clean_s, ends=()):
    """Laps from fresh starts: clean ones with these times, then some that ended at waypoints."""
    laps = [
        TrialReport(n, 100.0, lap_s, "Lap complete", 0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0)
        for n, lap_s in enumerate(clean_s, start=1)
    ]
    laps += [
        TrialReport(n, waypoint, 3.0, "Off track", 1, 0, 0, 0.0, 0.0, 0.0, 0.0, waypoint)
        for n, waypoint in enumerate(ends, start=len(laps) + 1)
    ]
    where = {"world": "reinvent_base", "simtrace": "t", "metrics": "m", "runtime": "torch"}
    return laps_report(laps, prefix=prefix, checkpoint="8.ckpt", seed=4, file=None, **where)


def test_laps_from_fresh_starts_are_told_as_a_distribution(dr, many, capsys):
    found = sample("model", *[7.5, 7.6] * 9, 9.4, ends=(99, 2))
    many["report"] = replace(TABLE, rows=[row("model")], laps=[found])

    code = dr("evaluate", "--laps", "21", "--seed", "4")
    shown = capsys.readouterr().out
    dr("evaluate", "--laps", "21", "--json")

    printed = " ".join(shown.split())
    assert code == 0
    assert (many["fresh_laps"], many["rival"]) == (21, None)
    assert "7.4 to 7.6 s 9 ████" in printed
    assert "off track 2 ████" in printed
    assert "waypoints 99 to 2 99 to 2 % 2 off track" in printed
    assert (
        "19 of 21 laps clean (71 to 97 % with 95 % confidence), median 7.60 s, 90 % within 7.60 s, "
        "slowest 9.40 s, best 7.50 s; checkpoint 8.ckpt of model on reinvent_base, seed 4."
    ) in printed
    assert max(map(len, shown.splitlines()[:-1])) <= 80
    told = json.loads(capsys.readouterr().out)
    assert (told["driven"], told["clean"], told["median_s"], told["slowest_s"]) == (
        21,
        19,
        7.6,
        9.4,
    )
    assert told["ends"][0]["statuses"] == {"Off track": 2}
    assert {"lap_s", "resets", "progress", "clean"} <= told["laps"][0].keys()


def test_two_checkpoints_are_compared_in_plain_words(dr, many, capsys):
    first = sample("model", *[7.5, 7.6] * 10)
    second = sample("other", *[7.7, 7.8] * 5, ends=[50] * 10)
    both = replace(first, against=second, comparison=compare(first, second))
    many["report"] = replace(TABLE, rows=[row("model"), row("other")], laps=[both])

    dr("evaluate", "--laps", "20", "--against", "team/other:last")

    printed = " ".join(capsys.readouterr().out.split())
    assert many["rival"] == Rival("team/other", "last")
    assert (
        "8.ckpt of model drives more clean laps than 8.ckpt of other, 20 against 10 of 20: more "
        "than chance (p = 0.002). 8.ckpt of model is 0.20 s a lap faster from the 10 starts where "
        "both were clean: more than chance (p = 0.002)."
    ) in printed


def test_few_pairs_of_times_are_not_compared_and_equal_drives_are_called_so():
    slow = sample("model", 9.0, 9.0, ends=[3])

    few = compare(sample("other", 8.0, 8.0, ends=[3]), slow)
    same = compare(sample("model", *[8.0] * 7), sample("model", *[8.0] * 7))

    assert few.time_p == 0.5
    assert few.verdict == (
        "Both drive equally many clean laps: 2 against 2 of 3. Their times cannot be compared: "
        "from too few starts both drove a clean lap."
    )
    assert same.clean_p == same.time_p == 1.0
    assert same.verdict.endswith("Both are equally fast from the 7 starts where both were clean.")


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

    monkeypatch.setattr("drcli.run.evaluation_loop.run_loop", loop)

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
    monkeypatch.setattr("drcli.run.evaluation.evaluate", lambda *_, **__: driven)

    dr("evaluate")

    printed = " ".join(capsys.readouterr().out.split())
    assert "2 finished, best 13.42 s; policy.pb with --runtime openvino on" in printed


@pytest.mark.parametrize(
    ("failure", "code"),
    [(WorkerDied("It died.", remedy="Read its log."), 5), (KeyboardInterrupt(), 130)],
)
def test_an_evaluation_that_does_not_end_prints_no_result(
    dr, working_folder, monkeypatch, capsys, failure, code
):
    def evaluate(*_, **__):
        raise failure

    monkeypatch.setattr("drcli.run.evaluation.evaluate", evaluate)

    assert dr("evaluate", "--json") == code
    printed = capsys.readouterr().out
    assert not printed or json.loads(printed).keys() == {"error", "remedy", "code"}


@pytest.fixture
def launched(working_folder, monkeypatch):
    """What is started in the background; it is nothing."""
    seen = {}

    def prepare(settings, *, clone, seed, own, opponent, on_progress):
        seen["clone"] = clone
        on_progress("Evaluation of model s3://bucket/model starting.")
        job = Job(settings.run, "abc", 7, None, settings.directory / "data", 1)
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

    monkeypatch.setattr("drcli.run.evaluation_plan.prepare_evaluation", prepare)
    monkeypatch.setattr("drcli.run.evaluation.launch_evaluation", launch)
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


@pytest.mark.parametrize(("name", "code"), [("start-evaluation", 1), ("evaluate", 0)])
def test_the_references_name_refuses_a_second_evaluation_as_the_reference_does(
    dr, asked, monkeypatch, capsys, name, code
):
    running = SimpleNamespace(bucket="bucket", prefix="model", pid=4242)
    monkeypatch.setattr("drcli.run.stopping.running_evaluations", lambda *_: [running])

    assert dr(name) == code

    said = capsys.readouterr().err
    assert ("An evaluation of s3://bucket/model is running (process 4242)" in said) == (code == 1)
    assert ("`dr-stop-evaluation`" in said) == (code == 1)
