"""`dr status` as its caller meets it."""

import json
from dataclasses import replace


def test_status_before_the_first_start_says_how_to_start(dr, run, capsys):
    code = dr("status")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == "Nothing was started here yet. Start with `dr-start-training`.\n"


def test_status_of_a_living_run_exits_0(dr, run, make_report, capsys):
    run.before = make_report("running", 4)

    code = dr("status")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.err == ""
    assert "running  s3://bucket/model  on reinvent_base" in printed.out


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


def _with_dead_worker(report):
    trainer, sim = report.workers
    return replace(report, workers=[trainer, replace(sim, alive=False)])
