"""`dr logs` as its caller meets it."""

import os

import pytest

from drcli.base import log_files
from drcli.cli import log_tail

LINES = [f"line {k}\n" for k in range(30)]


@pytest.fixture
def meanwhile(monkeypatch):
    """Makes something happen at each wait; Ctrl-C comes when nothing is left to happen."""

    def plan(*events):
        left = list(events)

        def wait(seconds):
            if not left:
                raise KeyboardInterrupt
            left.pop(0)()

        monkeypatch.setattr(log_tail.time, "sleep", wait)

    return plan


def test_the_last_lines_of_the_first_simulation_worker_are_shown(dr, log, capsys):
    log("sim-0").write_text("".join(LINES) + "a last line without an end")

    code = dr("logs")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == "".join(LINES[-19:]) + "a last line without an end"
    assert printed.err == ""


def test_all_of_a_log_is_shown_on_request(dr, log, capsys):
    log("trainer").write_text("".join(LINES))

    dr("logs", "trainer", "-a")

    assert capsys.readouterr().out == "".join(LINES)


def test_all_of_a_log_has_its_older_parts_too_and_nothing_of_earlier_trainings(dr, log, capsys):
    path = log("trainer")
    path.write_text("older\n")
    os.close(log_files.rotate(path, 1000))
    path.write_text("newest\n")
    path.with_name("trainer.log.20260102-030405").write_text("another training\n")

    dr("logs", "trainer", "-a")
    everything = capsys.readouterr().out
    dr("logs", "trainer")

    assert everything == "older\nnewest\n"
    assert capsys.readouterr().out == "newest\n"


@pytest.mark.parametrize("arguments", [["sim", "-n", "1"], ["sim-1"], ["-n", "1"]])
def test_a_simulation_worker_is_chosen_by_number(dr, log, capsys, arguments):
    log("sim-1").write_text("I am one\n")

    dr("logs", *arguments)

    assert capsys.readouterr().out == "I am one\n"


def test_following_goes_on_until_ctrl_c_which_is_no_failure(dr, log, capsys, meanwhile):
    path = log("sim-0")
    path.write_text("old\n")
    meanwhile(lambda: path.write_text("old\nnew\n"))

    code = dr("logs", "-f")

    assert code == 0
    assert capsys.readouterr().out == "old\nnew\n"


def test_a_long_log_is_followed_without_a_wait_between_its_pieces(
    dr, log, capsys, meanwhile, monkeypatch
):
    monkeypatch.setattr(log_tail, "_MOST_BYTES", 30)
    log("sim-0").write_text("".join(LINES))
    meanwhile()  # Ctrl-C at the first wait

    dr("logs", "-f", "-a")

    assert capsys.readouterr().out == "".join(LINES)


def test_following_waits_for_a_log_that_comes_late_and_says_so(dr, log, capsys, meanwhile):
    path = log("sim-0")
    meanwhile(lambda: None, lambda: path.write_text("".join(LINES)))

    dr("logs", "-f")

    printed = capsys.readouterr()
    assert printed.out == "".join(LINES)
    assert printed.err == f"Waiting for {path} ...\n"


@pytest.mark.parametrize("worker", ["trainer", "evaluation"])
def test_a_missing_log_exits_1_and_says_how_to_wait_for_it(dr, working_folder, capsys, worker):
    code = dr("logs", worker)

    said = capsys.readouterr().err
    assert code == 1
    assert f"{worker}.log" in said
    assert "-f" in said


def test_the_log_of_a_worker_that_there_never_is_is_not_worth_waiting_for(
    dr, working_folder, capsys
):
    code = dr("logs", "-n", "7")

    said = capsys.readouterr().err
    assert code == 1
    assert "Try: There are workers 0 to 1: DR_WORKERS is 2." in said


def test_a_single_worker_is_not_called_a_range(dr, working_folder, capsys):
    dr("config", "set", "DR_WORKERS=1")
    capsys.readouterr()

    dr("logs", "-n", "7")

    assert "Try: There is only worker 0: DR_WORKERS is 1." in capsys.readouterr().err


def test_an_unknown_worker_exits_2_with_those_there_are(dr, working_folder, capsys):
    code = dr("logs", "sagemaker")

    said = capsys.readouterr().err
    assert code == 2
    assert "'sagemaker' is not one of sim, trainer, supervisor, evaluation." in said
