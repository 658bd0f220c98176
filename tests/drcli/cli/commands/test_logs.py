"""`dr logs` as its caller meets it."""

import os
import time

import pytest

from drcli.base import log as log_files
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


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["reward"], "reward-0"),
        (["reward", "-n", "1"], "reward-1"),
        (["reward-1"], "reward-1"),
        (["reward-evaluation"], "reward-evaluation"),
    ],
)
def test_what_the_reward_function_prints_is_shown_alone(dr, log, capsys, arguments, name):
    log("sim-0").write_text("SIM_TRACE_LOG:0\nprinted\n")
    log(name).write_text("printed\n")

    assert dr("logs", *arguments) == 0

    assert capsys.readouterr().out == "printed\n"


def test_json_lines_are_shown_as_they_are(dr, log, capsys):
    log("trainer").with_suffix(".jsonl").write_text('{"level": "INFO"}\n')

    dr("logs", "trainer", "--json-lines")

    assert capsys.readouterr().out == '{"level": "INFO"}\n'


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["reward"], "The reward function has printed nothing yet"),
        (["reward", "-n", "7"], "There are workers 0 to 1"),
        (["reward-evaluation"], "DR_EVAL_DEBUG_REWARD=True"),
        (["sim", "--json-lines"], "DR_LOG_JSON=True"),
    ],
)
def test_who_misses_a_log_learns_where_it_comes_from(dr, working_folder, capsys, arguments, remedy):
    assert dr("logs", *arguments) == 1

    assert remedy in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "worker"), [("reward", "sim-0"), ("reward-evaluation", "evaluation")]
)
def test_prints_as_json_lines_are_in_those_of_their_worker(dr, log, capsys, name, worker):
    code = dr("logs", name, "--json-lines")

    assert code == 3
    assert f"`dr-logs {worker} --json-lines`" in capsys.readouterr().err


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
    assert "'sagemaker' is not one of sim, trainer, supervisor, evaluation, reward." in said


@pytest.fixture
def uploaded(working_folder):
    """Puts the copy of a log into the bucket; its server does not run."""

    def put(key, text):
        path = working_folder / "data" / "s3" / "bucket" / key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    return put


@pytest.mark.parametrize(
    ("arguments", "file", "shown"),
    [
        (["sim"], "robomaker/sim-0.log", LINES[-20:]),
        (["sim", "-n", "1", "--lines", "3"], "robomaker/sim-1.log", LINES[-3:]),
        (["trainer", "-a"], "sagemaker/trainer.log", LINES),
        (["reward", "-n", "1", "-l", "0"], "reward/reward-1.log", []),
        (["sim", "--json-lines", "-l", "1"], "robomaker/sim-0.jsonl", LINES[-1:]),
    ],
)
def test_a_log_of_another_machine_is_read_from_the_bucket(
    dr, uploaded, capsys, arguments, file, shown
):
    uploaded(f"model/logs/{file}.part-000001", "".join(LINES[:17]))
    uploaded(f"model/logs/{file}", "".join(LINES[17:]))

    assert dr("logs", *arguments) == 0

    printed = capsys.readouterr()
    assert printed.out == "".join(shown)
    assert f"Reading s3://bucket/model/logs/{file}, uploaded 20" in printed.err


def test_the_log_of_this_machine_comes_first_unless_the_copy_is_asked_for(
    dr, log, uploaded, capsys
):
    uploaded("model/logs/robomaker/sim-0.log", "uploaded\n")
    log("sim-0").write_text("here\n")

    dr("logs")
    assert capsys.readouterr().out == "here\n"
    dr("logs", "--uploaded")
    assert capsys.readouterr().out == "uploaded\n"


def test_who_asks_for_a_copy_that_does_not_exist_learns_so(dr, log, capsys):
    log("sim-0").write_text("here\n")

    assert dr("logs", "--uploaded") == 1

    assert "s3://bucket/model has no copy of sim-0.log." in capsys.readouterr().err


def test_a_copy_is_followed_until_the_log_appears_here(dr, log, uploaded, capsys, meanwhile):
    key, path = "model/logs/robomaker/sim-0.log", log("sim-0")
    uploaded(key, "old\n")
    meanwhile(lambda: path.write_text("here\n"))

    dr("logs", "-f")

    assert capsys.readouterr().out == "old\nhere\n"


def test_a_copy_is_followed_as_it_grows(dr, uploaded, capsys, meanwhile, monkeypatch):
    from drcli.cli.commands import logs

    monkeypatch.setattr(logs, "UPLOAD_POLL_S", 0.0001)
    key = "model/logs/sagemaker/trainer.log"
    uploaded(key, "old\n")

    def grow():
        uploaded(key, "old\nnew\n")
        look = time.monotonic() + logs.UPLOAD_POLL_S
        while time.monotonic() < look:
            pass  # the next wait would be Ctrl-C: the pause must be over

    meanwhile(grow)

    assert dr("logs", "trainer", "-f") == 0

    assert capsys.readouterr().out == "old\nnew\n"


TIMED = [f"2026-11-22T09:{minute}:00.000Z INFO At {minute}.\nuntimed\n" for minute in range(10, 50)]


@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        (["--since", "2026-11-22T09:40"], TIMED[30:]),
        (["--since", "2026-11-22T11:40+02:00"], TIMED[30:]),
        (["--since", "2026-11-22", "-l", "1"], ["untimed\n"]),
        (["--since", "2026-11-23"], []),
    ],
)
@pytest.mark.parametrize("is_here", [True, False])
def test_a_log_is_shown_since_a_time(dr, log, uploaded, capsys, arguments, shown, is_here):
    older, newest = "".join(TIMED[:20]), "".join(TIMED[20:])
    if is_here:
        path = log("sim-0")
        path.with_name("sim-0.log.part-0001").write_text(older)
        path.write_text(newest)
    else:
        uploaded("model/logs/robomaker/sim-0.log.part-000001", older)
        uploaded("model/logs/robomaker/sim-0.log", newest)

    assert dr("logs", *arguments) == 0

    assert capsys.readouterr().out == "".join(shown)


def test_json_lines_are_shown_since_a_time(dr, log, capsys):
    rows = [f'{{"time": "2026-11-22T09:{k}:00.000Z", "level": "INFO"}}\n' for k in range(10, 20)]
    log("trainer").with_suffix(".jsonl").write_text("".join(rows))

    dr("logs", "trainer", "--json-lines", "--since", "2026-11-22T09:18")

    assert capsys.readouterr().out == "".join(rows[8:])


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["reward", "--since", "1h"], 3, "`dr-logs sim-0 --json-lines --since 1h`"),
        (["sim", "--since", "yesterday"], 3, "--since yesterday is neither a date nor an age."),
        (["sim", "-a", "-l", "3"], 2, "--all and --lines exclude each other."),
    ],
)
def test_what_cannot_be_shown_has_a_reason(dr, working_folder, capsys, arguments, code, said):
    assert dr("logs", *arguments) == code

    assert said in capsys.readouterr().err
