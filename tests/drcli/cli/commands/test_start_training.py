"""`dr start-training` as its caller meets it."""

import io
import json

import pytest

from drcli.base.errors import Problem, SettingsError, refuse
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from memory_bucket import MemoryBucket


def test_a_start_says_what_is_trained_from_which_files(dr, run, make_report, capsys):
    run.looks = [make_report("finished", 1)]

    dr("start-training")

    said = capsys.readouterr().err
    assert "Training of model s3://bucket/model starting." in said
    assert "World reinvent_base, 2 workers, seed 7." in said
    assert "   custom_files/reward_function.py\n" in said
    assert "\nEnds some day.\n" in said


def test_after_a_launch_the_next_commands_stand_ready_to_paste(dr, run, make_report, capsys):
    run.looks = [make_report("finished", 1)]

    dr("start-training")

    lines = capsys.readouterr().err.splitlines()
    at = lines.index("Next:")
    commands = [line.strip() for line in lines[at + 2 : at + 9 : 2]]
    assert commands == ["dr-attach", "dr-logs trainer -f", "dr-status", "dr-stop-training"]


def test_away_from_a_terminal_every_iteration_becomes_one_line(dr, run, make_report, capsys):
    run.looks = [
        make_report("starting"),
        make_report("running", 1),
        make_report("running", 2),
        make_report("running", 2),
        make_report("finished", 3),
    ]

    code = dr("start-training")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == ""
    numbers = [line.split()[2] for line in printed.err.splitlines() if _is_iteration(line)]
    assert numbers == ["0", "1", "2"]


def test_iterations_of_an_earlier_start_are_not_repeated(dr, run, make_report, capsys):
    run.before = make_report("stopped", 2)
    run.looks = [make_report("finished", 3)]

    dr("start-training", "--resume")

    lines = [line for line in capsys.readouterr().err.splitlines() if _is_iteration(line)]
    assert len(lines) == 1
    assert lines[0].split()[1:3] == ["iter", "2"]


def test_an_iteration_that_is_driven_again_gets_a_line_again(
    dr, run, make_report, make_record, capsys
):
    again = make_report("finished", history=[make_record(0), make_record(1, elapsed_s=99.0)])
    run.before = make_report("stopped", 2)
    run.looks = [again]

    dr("start-training", "--resume")

    lines = [line for line in capsys.readouterr().err.splitlines() if _is_iteration(line)]
    assert len(lines) == 1
    assert lines[0].split()[0] == "1:39"


def test_verbose_lines_hold_losses_and_where_the_time_went(dr, run, make_report, capsys):
    run.looks = [make_report("finished", 1)]

    dr("start-training", "-v")

    said = capsys.readouterr().err
    assert "value loss 0.4500  KL 0.0021" in said
    assert "drive 0.6 s  learn 0.7 s  exchange 0.1 s" in said


def test_quiet_returns_after_the_launch_with_a_single_line(dr, run, make_report, capsys):
    run.warnings = ["Odd."]
    run.looks = [make_report("running")]

    code = dr("start-training", "-q")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == ""
    assert printed.err == "Training of model s3://bucket/model starting.\n"


def test_quiet_json_describes_the_run_that_has_begun(dr, run, make_report, capsys):
    run.looks = [make_report("running")]

    dr("start-training", "-q", "--json")

    assert json.loads(capsys.readouterr().out)["state"] == "running"


def test_json_is_the_last_and_only_thing_on_stdout(dr, run, make_report, capsys):
    run.looks = [make_report("running", 1), make_report("finished", 2)]

    dr("start-training", "--json")

    report = json.loads(capsys.readouterr().out)
    assert report["state"] == "finished"
    assert report["dead"] == []
    assert [record["iteration"] for record in report["history"]] == [0, 1]


def test_the_exit_code_is_that_of_the_training(dr, run, make_report, capsys):
    run.looks = [
        make_report("running", 1),
        make_report("failed", 1, message="NaN.", remedy="Lower lr.", exit_code=6),
    ]

    code = dr("start-training")

    said = capsys.readouterr().err
    assert code == 6
    assert "Error: NaN.\n  Try: Lower lr.\n" in said


def test_a_training_whose_supervisor_vanishes_counts_as_a_dead_worker(dr, run, make_report, capsys):
    run.looks = [make_report("running", 1), make_report("lost", 1, message="Gone.", exit_code=None)]

    code = dr("start-training")

    assert code == 5
    assert "Error: Gone." in capsys.readouterr().err


def test_a_supervisor_that_never_starts_is_not_mistaken_for_the_run_before_it(
    dr, run, make_report, capsys
):
    run.looks = [make_report("finished", 3, pid=1)]

    code = dr("start-training")

    assert code == 5
    assert "dr-logs supervisor" in capsys.readouterr().err


def test_ctrl_c_detaches_and_says_how_to_come_back(dr, run, make_report, capsys):
    run.looks = [make_report("running"), make_report("running", 1), KeyboardInterrupt()]

    code = dr("start-training")

    said = capsys.readouterr().err
    assert code == 130
    assert said.index("Detached; the training continues.") < said.rindex("dr-stop-training")
    assert "stop" not in run.asked


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("plan.prepare", "Interrupted; no training was started."),
        ("training.launch", "Interrupted while the workers started; `dr-status` says"),
    ],
)
def test_ctrl_c_before_the_display_says_what_is_left(dr, run, capsys, monkeypatch, place, said):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(f"drcli.run.{place}", interrupted)

    code = dr("start-training")

    assert code == 130
    assert said in capsys.readouterr().err


def test_a_refusal_starts_nothing_and_ends_with_its_own_code(dr, run, capsys):
    run.refusal = SettingsError("run.env line 1: no.", remedy="Change it.")

    code = dr("start-training")

    assert code == 3
    assert run.asked == ["prepare"]
    assert capsys.readouterr().err == "Error: run.env line 1: no.\n  Try: Change it.\n"


def test_each_file_that_is_wrong_is_named_with_its_own_remedy(dr, run, capsys):
    same = "Compare it with the file of the same kind that `dr init` writes."
    with pytest.raises(SettingsError) as refusal:
        refuse(
            [
                Problem("V-04", "error", "hyperparameters.json", 2, "No comma.", "Put one."),
                Problem("V-03", "error", "model_metadata.json", 1, "It is empty.", same),
                Problem("V-03", "error", "model_metadata.json", 9, "It is torn.", same),
            ]
        )
    run.refusal = refusal.value

    dr("start-training")

    assert capsys.readouterr().err.splitlines() == [
        "Error: model_metadata.json line 1: It is empty.",
        f"  Try: {same}",
        "Error: model_metadata.json line 9: It is torn.",
        f"  Try: {same}",
        "Error: hyperparameters.json line 2: No comma.",
        "  Try: Put one.",
    ]


def test_what_is_allowed_but_odd_is_said(dr, run, make_report, capsys):
    run.warnings = ["lr is high."]
    run.looks = [make_report("finished", 1)]

    dr("start-training")

    assert "Warning: lr is high." in capsys.readouterr().err


def test_options_reach_the_start(dr, run, make_report):
    run.looks = [make_report("finished", 1)]

    dr(
        *("start-training", "-w", "--max-minutes", "1.5", "--seed", "5"),
        *("--until-laps", "3", "--until-lap-time", "8.5"),
    )

    assert run.options is not None
    assert run.options.wipe
    assert not run.options.resume
    assert (run.options.max_minutes, run.options.seed) == (1.5, 5)
    assert run.options.goals == {"until_laps": 3, "until_lap_time_s": 8.5}


def test_in_the_foreground_this_process_runs_the_training(dr, run, make_report, capsys):
    run.looks = [make_report("finished", 2)]

    code = dr("start-training", "--foreground", "--json")

    printed = capsys.readouterr()
    assert code == 0
    assert run.asked == ["prepare", "supervise_job"]
    assert len([line for line in printed.err.splitlines() if _is_iteration(line)]) == 2
    assert json.loads(printed.out)["state"] == "finished"


def test_following_a_log_shows_what_comes_after_the_start(dr, run, make_report, log, capsys):
    log("trainer").write_text("an old line\n")
    run.looks = [make_report("running"), make_report("finished", 1)]
    run.between = lambda: log("trainer").write_text("an old line\na new line\n")

    code = dr("start-training", "-s")

    printed = capsys.readouterr()
    assert code == 0
    assert "a new line\n" in printed.err
    assert "an old line" not in printed.err
    assert printed.out == ""


def test_a_number_after_r_chooses_the_worker(dr, run, make_report, log, capsys):
    run.looks = [make_report("running"), make_report("finished", 1)]
    run.between = lambda: log("sim-1").write_text("from one\n")

    dr("start-training", "-r", "1")

    assert "\nfrom one\n" in capsys.readouterr().err


def test_all_logs_are_told_apart_by_their_workers(dr, run, make_report, log, capsys):
    log("trainer").write_text("")
    run.looks = [make_report("running"), make_report("finished", 1)]
    run.between = lambda: log("sim-0").write_text("drives\n")

    dr("start-training", "-a")

    assert "sim-0: drives\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["1"], "needs -r"),
        (["-r", "2"], "DR_WORKERS is 2"),
        (["--until-laps", "0"], "must be at least 1."),
    ],
)
def test_wrong_numbers_on_the_command_line_exit_2(dr, run, capsys, arguments, words):
    code = dr("start-training", *arguments)

    assert code == 2
    assert words in capsys.readouterr().err
    assert run.asked == []


def _is_iteration(line):
    return line.split()[1:2] == ["iter"]


def test_the_flags_of_the_reference_may_stand_together(dr, run, make_report, capsys):
    run.looks = [make_report("running")]

    code = dr("start-training", "-qwv")

    assert code == 0
    assert run.options is not None
    assert run.options.wipe
    assert capsys.readouterr().err == "Training of model s3://bucket/model starting.\n"


@pytest.mark.parametrize(
    ("flags", "typed", "starts"),
    [(["-w"], "\n", False), (["-w"], "y\n", True), (["-w", "-f"], "", True), ([], "", True)],
)
def test_on_a_terminal_nothing_is_deleted_without_a_yes(
    dr, run, make_report, capsys, monkeypatch, flags, typed, starts
):
    run.looks = [make_report("finished", 1)]
    bucket = MemoryBucket()
    CheckpointStore(ModelStore(bucket, "model")).save(7, 100, b"weights")
    monkeypatch.setattr("drcli.bucket.connect.open_bucket", lambda *_, **__: bucket)
    monkeypatch.setattr("drcli.cli.prompts.may_ask", lambda: True)
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))

    code = dr("start-training", "-q", *flags)

    said = capsys.readouterr().err
    assert code == (0 if starts else 1)
    asked = "Delete s3://bucket/model, which has checkpoints up to 7?" in said
    assert asked is (flags == ["-w"])
    assert ("Add -f (or --yes)" in said) is not starts


def test_a_wiped_model_is_named_as_the_reference_names_it(dr, run, make_report, capsys):
    run.wiped = True
    run.looks = [make_report("finished", 1)]

    dr("start-training", "-w")

    said = capsys.readouterr().err.splitlines()
    assert said[:2] == [
        "Wiping path s3://bucket/model",
        "Training of model s3://bucket/model starting.",
    ]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--seed", str(10**17)),
        ("--seed", str(2**32)),
        ("--seed", "-1"),
        ("--max-minutes", "inf"),
        ("--max-minutes", "nan"),
        ("--max-minutes", "1e300"),
        ("--max-minutes", "0"),
    ],
)
def test_a_number_that_no_worker_could_read_is_refused_at_once(dr, run, capsys, option, value):
    code = dr("start-training", option, value)

    assert code == 2
    assert option in capsys.readouterr().err


@pytest.mark.parametrize("options", [("--seed", str(2**32 - 1)), ("--max-minutes", "0.5")])
def test_numbers_at_the_limits_are_accepted(dr, run, make_report, options):
    run.looks = [make_report("finished", 1)]

    assert dr("start-training", *options) == 0
