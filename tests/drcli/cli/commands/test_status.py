"""`dr status` as its caller meets it."""

import json
from dataclasses import replace

import pytest

from drcli.model.alarms import Convergence
from drcli.model.training_state import Rollback
from drcli.records.reward import RewardCounts, RewardErrorEntry


def test_status_before_the_first_start_says_how_to_start(dr, run, capsys):
    code = dr("status")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out.startswith("Nothing was started here yet. Start with `dr-start-training`,")


def test_status_of_a_living_run_exits_0(dr, run, make_report, capsys):
    run.before = make_report("running", 4)

    code = dr("status")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.err == ""
    assert "running  s3://bucket/model  on reinvent_base" in printed.out


@pytest.mark.parametrize("overridden", ["model", "model-1"])
def test_status_suggests_commands_for_the_model_that_it_shows(
    dr, run, make_report, monkeypatch, capsys, overridden
):
    run.before = make_report("finished", 4, prefix="model")
    monkeypatch.setenv("DR_LOCAL_S3_MODEL_PREFIX", overridden)

    assert dr("status") == 0
    assert "\n    DR_LOCAL_S3_MODEL_PREFIX=model dr-" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["attach"], ["status", "-f"]])
def test_a_running_training_is_followed_again_until_its_end(dr, run, make_report, capsys, words):
    run.before = make_report("running", 2)
    run.looks = [make_report("running", 3), make_report("failed", 4, message="NaN.", exit_code=6)]

    code = dr(*words)

    printed = capsys.readouterr()
    assert code == 6
    assert [line.split()[2] for line in printed.err.splitlines() if " iter " in line] == ["2", "3"]
    assert "Error: NaN." in printed.err


def test_leaving_the_display_names_the_way_back(dr, run, make_report, capsys):
    run.before = make_report("running", 2)
    run.looks = [make_report("running", 2), KeyboardInterrupt()]

    code = dr("attach")

    said = capsys.readouterr().err
    assert code == 130
    assert "Detached; the training continues." in said
    assert "    dr-attach\n" in said


def test_attach_says_that_nothing_runs_and_shows_the_state(dr, run, make_report, capsys):
    run.before = make_report("finished", 4)

    code = dr("attach")

    printed = capsys.readouterr()
    assert code == 0
    assert "No training is running." in printed.err
    assert printed.out.startswith("Run 0: finished")


def test_status_of_a_dead_worker_names_it_and_exits_5(dr, run, make_report, capsys):
    run.before = _with_dead_worker(make_report("running", 4))

    code = dr("status", "--json")

    printed = capsys.readouterr()
    assert code == 5
    assert json.loads(printed.out)["dead"] == ["sim-0"]
    assert "Error: Dead: sim-0." in printed.err
    assert "dr-logs sim-0" in printed.err


def test_status_of_a_lost_run_exits_5(dr, run, make_report, capsys):
    run.before = make_report("lost", 4, message="The supervisor is gone.", exit_code=None)

    code = dr("status")

    assert code == 5
    assert "Error: The supervisor is gone." in capsys.readouterr().err


def test_status_of_a_failed_run_tells_why_and_exits_0(dr, run, make_report, capsys):
    run.before = make_report("failed", 4, message="NaN at step 3.", exit_code=6)

    code = dr("status")

    assert code == 0
    assert "NaN at step 3." in capsys.readouterr().out


def test_status_of_a_complete_training_says_how_to_repeat_what_failed_at_its_end(
    dr, run, make_report, capsys
):
    how = {"message": "The import failed.", "remedy": "Repeat it.", "exit_code": 3}
    run.before = make_report("finished", 4, **how)

    assert dr("status") == 0
    assert "The import failed.\n  Try: Repeat it.\n" in capsys.readouterr().out


def test_a_worker_that_ended_because_the_run_ends_is_not_a_fault(dr, run, make_report, capsys):
    run.before = replace(_with_dead_worker(make_report("running", 4)), ending=True)

    code = dr("status")

    shown = capsys.readouterr().out
    assert (code, "DEAD" in shown) == (0, False)
    assert "sim-0 (ended, process" in shown


def _with_dead_worker(report):
    trainer, sim = report.workers
    return replace(report, workers=[trainer, replace(sim, alive=False)])


def test_status_tells_of_failures_after_which_the_training_went_on(dr, run, make_report, capsys):
    entry = RewardErrorEntry(
        "raises", "KeyError", "KeyError: 'x'", 12, "y = p['x']", "{'a': 1}", 30
    )
    back = Rollback(1.0, "nan", "NaN detected", "9_Step-9.ckpt", "7_Step-7.ckpt", 0.003, 1 / 3, 9.0)
    run.before = replace(
        make_report("running", 4),
        reward_errors=RewardCounts(1000, 30, 2, [entry]),
        rollbacks=[back],
        convergence=Convergence(60.0, 90.0, reached=False),
        warning="the entropy rises",
        advice=["Lower `lr`."],
    )

    dr("status")

    printed = " ".join(capsys.readouterr().out.split())
    assert "Rollback: NaN detected. Went back from checkpoint 9 to 7 with a learning" in printed
    assert "Reward function: 30 of 1,000 calls failed (3 %), 2 episodes declared broken." in printed
    assert "line 12: KeyError: 'x' (30 times) y = p['x'] params = {'a': 1}" in printed
    assert "training 60 %, evaluations 90 %: a gap of 30 points." in printed
    assert "Warning: the entropy rises Try: Lower `lr`." in printed

    dr("status", "--json")

    report = json.loads(capsys.readouterr().out)
    assert report["reward_errors"]["errors"][0]["line"] == 12
    assert report["rollbacks"][0]["target"] == "7_Step-7.ckpt"
