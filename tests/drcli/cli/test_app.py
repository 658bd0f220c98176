"""The command line as a whole: names, exit codes, and what a failure looks like."""

import errno
import io
import json
import os
import subprocess
import sys
import tomllib
from functools import wraps
from importlib import import_module
from pathlib import Path

import pytest
import typer.main

from drcli import __version__
from drcli.base.errors import DrError, SettingsError, StorageError, TrainingFailed, WorkerDied
from drcli.base.processes import Stopped
from drcli.cli import terminal
from drcli.cli.app import main
from drcli.cli.command_line import application
from drcli.cli.command_table import COMMANDS, OF_REFERENCE, program_names
from drcli.cli.working_folder import settings

SLOW = {"torch", "mujoco", "boto3", "botocore", "numpy", "numba", "drsim"}
"""What showing help must not load."""


@pytest.fixture
def failing(working_folder, monkeypatch):
    """Lets `dr stop-training` fail in a chosen way."""

    def fail_with(failure):
        def is_running(*_):
            raise failure

        monkeypatch.setattr("drcli.run.stopping.is_running", is_running)

    return fail_with


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("dr-start-training", "start-training"),
        ("dr-stop-training", "stop-training"),
        ("dr-status", "status"),
        ("dr-logs", "logs"),
        ("dr-evaluate", "evaluate"),
        ("dr-start-evaluation", "start-evaluation"),
        ("dr-increment-training", "increment-training"),
        ("/usr/local/bin/dr-status.exe", "status"),
    ],
)
def test_a_command_is_reached_under_its_own_name(monkeypatch, capsys, name, command):
    monkeypatch.setattr("sys.argv", [name, "--help"])

    with pytest.raises(SystemExit) as end:
        main()

    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(f"Usage: dr {command} ")


def test_the_programs_that_are_installed_are_those_of_the_table():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text("utf-8"))

    installed = project["project"]["scripts"]
    assert installed.keys() - {"drcli-complete"} == program_names().keys()
    assert {installed[name] for name in program_names()} == {"drcli.cli.program:main"}


def test_dr_reaches_every_command_by_its_first_argument(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["/usr/local/bin/dr", "status", "--help"])

    with pytest.raises(SystemExit):
        main()

    assert capsys.readouterr().out.startswith("Usage: dr status ")


def test_the_version_goes_to_stdout(dr, capsys):
    code = dr("--version")

    assert code == 0
    assert capsys.readouterr().out == f"dr {__version__}\n"


@pytest.mark.parametrize("command", [["--version"], ["config", "check", "--settings"]])
def test_a_closed_input_is_as_good_as_an_empty_one(working_folder, command):
    program = f"from drcli.cli.app import main; main({command!r})"

    done = subprocess.run(
        ["bash", "-c", 'exec "$@" <&-', "bash", sys.executable, "-c", program],
        capture_output=True,
        text=True,
    )

    assert (done.returncode, done.stderr) == (0, "")


def test_a_full_disk_behind_the_output_is_one_sentence(working_folder):
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full here")
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                "from drcli.cli.app import main; main(['config', 'check', '--settings'])",
            ],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )

    assert done.returncode == 1
    assert done.stderr.startswith(
        "Error: The result cannot be written to standard output: No space"
    )


def test_another_folder_than_the_current_one_is_mentioned(dr, working_folder, monkeypatch, capsys):
    other = working_folder / "other"
    other.mkdir()
    (other / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=other\n")
    monkeypatch.setenv("DR_DIR", str(working_folder))
    monkeypatch.chdir(other)

    dr("config", "show", "DR_LOCAL_S3_MODEL_PREFIX")

    printed = capsys.readouterr()
    assert printed.out.startswith("DR_LOCAL_S3_MODEL_PREFIX=model ")
    assert f"Using DR_DIR={working_folder}, not {other}" in printed.err


def test_a_folder_that_is_none_is_blamed_on_its_variable(dr, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DR_DIR", str(tmp_path / "nowhere"))

    code = dr("status")

    assert code == 3
    assert capsys.readouterr().err.startswith("Error: environment: DR_DIR=")


@pytest.mark.parametrize("columns", ["0", "10"])
def test_a_width_that_nobody_can_read_is_not_believed(working_folder, columns):
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from drcli.cli.app import main; main(['config', 'check', '--settings'])",
        ],
        env={**os.environ, "COLUMNS": columns},
        capture_output=True,
        text=True,
    )

    assert "Settings: 0 errors" in done.stdout


def test_help_lists_all_exit_codes(dr, capsys):
    dr("--help", "--all")

    shown = capsys.readouterr().out
    codes = [line.split()[0] for line in shown[shown.index("Exit codes:") :].splitlines()[1:]]
    assert codes == ["0", "1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "75", "130", "143"]


@pytest.mark.parametrize("command", [[], ["start-training"]])
def test_help_loads_nothing_slow(command):
    program = (
        "import sys; from drcli.cli.app import main\n"
        f"try: main({[*command, '--help']!r})\n"
        f"finally: print({SLOW!r} & sys.modules.keys(), file=sys.stderr)"
    )

    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)

    assert done.returncode == 0
    assert done.stderr == "set()\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["start-training", "--wip"], "Possible options: --wipe"),
        (["status", "--jsno"], "--json"),
        (["start-trainin"], "No such command 'start-trainin'. Did you mean 'start-training"),
        (["statsu"], "No such command 'statsu'. Did you mean 'status'?"),
        (["dr-status"], "Did you mean 'status'?"),
        (["model"], "Did you mean 'list-models'?"),
        (["STATUS"], "No such command 'STATUS'. Did you mean 'status'?"),
        (["train"], "'start-training', 'stop-training', 'increment-training'?"),
        (["tracks", "lits"], "Did you mean 'list', 'limit'?"),
        (["start-training", "--seed", "x"], "--seed"),
    ],
)
def test_a_wrong_command_line_exits_2_and_suggests_the_right_one(dr, capsys, arguments, words):
    code = dr(*arguments)

    printed = capsys.readouterr()
    assert code == 2
    assert printed.out == ""
    assert words in printed.err


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            "config set DR_RUN_ID=0 --file foo",
            "Invalid value for '--file': 'foo' is not one of 'run.env', 'system.env'.",
        ),
        ("url bla", "'bla' is not one of 'bucket', 'model', "),
        ("completion show tcsh", "'tcsh' is not one of 'bash', 'zsh', 'fish'."),
        ("start-training --seed x", "Invalid value for '--seed': 'x' is not a whole number."),
        ("start-training --max-minutes x", "'x' is not a number."),
        ("start-training --max-minutes 0", "'0' must be at least 0.01."),
        ("start-training --seed 4294967296", "'4294967296' must be at most 4294967295."),
        ("logs -n -1", "'-1' must be at least 0."),
        ("logs -n 1.5", "'1.5' is not a whole number."),
    ],
)
def test_a_value_of_the_wrong_type_is_explained_in_plain_words(
    dr, working_folder, capsys, line, words
):
    code = dr(*line.split())

    said = capsys.readouterr().err
    assert code == 2
    assert words in said
    assert "Value error" not in said
    assert "Input should" not in said


def test_a_word_like_no_command_gets_no_hint(dr, capsys):
    code = dr("xyzzy")

    assert code == 2
    assert "No such command 'xyzzy'.\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line", [["-q", "init"], ["init", "--quiet"], ["--quiet", "init", "-q"]], ids=" ".join
)
def test_quiet_spares_words_and_keeps_results(dr, working_folder, capsys, line):
    code = dr(*line, "made", "--json")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.err == ""
    assert '"written"' in printed.out


def test_quiet_does_not_last_longer_than_its_command(dr, working_folder, capsys):
    dr("-q", "init", "one")

    dr("init", "two")

    assert "files written" in capsys.readouterr().err


def test_quiet_keeps_warnings_and_failures(dr, working_folder, capsys):
    dr("-q", "init", "made", "--world", "Oval_track")
    dr("-q", "init", "made", "--cloud", "x")

    said = capsys.readouterr().err
    assert "Warning: DR_WORLD_NAME=Oval_track" in said
    assert "Error: " in said


@pytest.mark.parametrize("command", [c for c in COMMANDS if not c.takes_any], ids=lambda c: c.name)
def test_every_command_of_ours_can_be_quiet(command):
    loaded = typer.main.get_command(application([command.name])).commands[command.name]

    for single in getattr(loaded, "commands", {"": loaded}).values():
        assert "--quiet" in {name for option in single.params for name in option.opts}


@pytest.mark.parametrize(
    ("kind", "code"),
    [(DrError, 1), (SettingsError, 3), (StorageError, 4), (WorkerDied, 5), (TrainingFailed, 6)],
)
def test_an_explained_failure_is_a_sentence_a_remedy_and_a_code(dr, failing, capsys, kind, code):
    failing(kind("It broke.", remedy="Mend it."))

    ended = dr("stop-training")

    printed = capsys.readouterr()
    assert ended == code
    assert printed.out == ""
    assert printed.err == "Error: It broke.\n  Try: Mend it.\n"


def test_a_disk_that_is_full_under_an_open_file_is_no_bug(dr, failing, capsys):
    failing(OSError(errno.ENOSPC, "No space left on device"))

    assert dr("stop-training") == 3

    said = capsys.readouterr().err
    assert "The disk of the working folder cannot be used: No space left on device." in said
    assert "Free some disk space" in said


def test_a_stop_that_somebody_wanted_is_no_error(dr, failing, capsys):
    failing(Stopped("It was stopped.", remedy="Start it again."))

    code = dr("stop-training")

    assert (code, capsys.readouterr().err) == (143, "It was stopped. Start it again.\n")


def test_wrong_settings_exit_3_before_anything_happens(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=many\n")

    code = dr("status")

    assert code == 3
    assert "run.env line 1" in capsys.readouterr().err


def test_dr_dir_names_the_working_folder(dr, working_folder, tmp_path_factory, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    monkeypatch.setenv("DR_DIR", str(working_folder))

    code = dr("status")

    assert code == 0
    assert "Nothing was started" in capsys.readouterr().out


def test_folders_above_are_told_without_dots(dr, working_folder, monkeypatch, capsys):
    (working_folder / "elsewhere").mkdir()
    monkeypatch.chdir(working_folder / "elsewhere")
    monkeypatch.setenv("DR_DIR", "..")
    (working_folder / "system.env").write_text("DR_CLOUD=local\nDR_S3_DATA_DIR=../objects\n")

    loaded = settings()

    assert loaded.directory == working_folder
    assert loaded.storage.data_dir == working_folder.parent / "objects"


@pytest.fixture
def gone(tmp_path_factory, monkeypatch):
    """The current folder was deleted."""
    folder = tmp_path_factory.mktemp("gone")
    monkeypatch.chdir(folder)
    folder.rmdir()


def test_dr_dir_counts_even_where_the_current_folder_is_gone(
    dr, working_folder, gone, monkeypatch, capsys
):
    monkeypatch.setenv("DR_DIR", str(working_folder))

    code = dr("status")

    assert code == 0
    assert "Nothing was started" in capsys.readouterr().out


@pytest.mark.parametrize("relative", [None, "racer"])
def test_a_current_folder_that_is_gone_is_one_sentence(
    dr, working_folder, gone, monkeypatch, capsys, relative
):
    if relative is not None:
        monkeypatch.setenv("DR_DIR", relative)

    code = dr("status")

    assert code == 3
    assert capsys.readouterr().err.startswith("Error: The current folder was deleted.")


def test_a_bug_in_a_folder_that_is_gone_is_one_sentence(dr, failing, gone, monkeypatch, capsys):
    def fail(*_):
        raise ZeroDivisionError

    monkeypatch.setattr("drcli.cli.commands.stop.working_folder", fail)

    code = dr("stop-training")

    assert code == 1
    assert "Internal error in drcli: ZeroDivisionError" in capsys.readouterr().err


def test_ctrl_c_exits_130_with_a_word(dr, failing, capsys):
    failing(KeyboardInterrupt())

    code = dr("stop-training")

    printed = capsys.readouterr()
    assert code == 130
    assert (printed.out, printed.err) == ("", "Interrupted.\n")


def test_an_interrupt_that_a_library_wrapped_is_no_bug(dr, failing, capsys):
    failing(ValueError("Error building a model: KeyboardInterrupt: "))

    code = dr("stop-training")

    printed = capsys.readouterr()
    assert code == 130
    assert (printed.out, printed.err) == ("", "Interrupted.\n")


def test_a_program_that_is_interrupted_while_it_loads_exits_130(tmp_path):
    (tmp_path / "typer.py").write_text("raise KeyboardInterrupt")
    program = "from drcli.cli.program import main; main()"

    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )

    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_a_bug_is_one_sentence_and_keeps_its_traceback_in_a_file(
    dr, failing, working_folder, capsys
):
    failing(ZeroDivisionError("division by zero"))

    code = dr("stop-training")

    said = capsys.readouterr().err
    [crash] = (working_folder / "data" / "logs").glob("crash-*.txt")
    assert code == 1
    assert "Internal error in drcli: ZeroDivisionError: division by zero" in said
    assert str(crash) in said
    assert "Traceback" not in said
    assert "Traceback" in crash.read_text()


def test_a_bug_in_a_folder_that_cannot_be_written_says_how_to_see_more(
    dr, failing, working_folder, capsys
):
    (working_folder / "data").write_text("in the way")
    failing(ZeroDivisionError())

    code = dr("stop-training")

    assert code == 1
    assert "DR_DEBUG=1" in capsys.readouterr().err


def test_dr_debug_shows_a_bug_as_it_is(failing, monkeypatch):
    monkeypatch.setenv("DR_DEBUG", "1")
    failing(ZeroDivisionError())

    with pytest.raises(ZeroDivisionError):
        main(["stop-training"])


@pytest.mark.parametrize("command", [["status"], ["status", "--json"], ["logs"]])
def test_a_reader_that_has_seen_enough_ends_the_command_quietly(working_folder, command):
    log = working_folder / "data" / "logs" / "robomaker" / "model" / "sim-0.log"
    log.parent.mkdir(parents=True)
    log.write_text("line\n")
    read_end, write_end = os.pipe()
    os.close(read_end)

    done = subprocess.run(
        [sys.executable, "-c", f"from drcli.cli.app import main; main({command!r})"],
        stdout=write_end,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(write_end)

    assert done.stderr == ""
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["export", "pb", "--out", "a/" * 3000 + "b.pb"], "File name too long"),
        (["init", "9" * 300], "File name too long"),
    ],
)
def test_a_path_that_no_system_allows_is_refused_in_one_sentence(
    working_folder, capsys, arguments, words
):
    with pytest.raises(SystemExit) as end:
        main(arguments)

    said = capsys.readouterr().err
    assert end.value.code == 3
    assert words in said
    assert "Try: " in said
    assert "Internal error" not in said
    assert not list(working_folder.rglob("crash-*"))


@pytest.fixture
def words_of(monkeypatch):
    """What a command is called with, without doing it."""

    def call(*arguments):
        module, name = next(each for each in COMMANDS if each.name == arguments[0]).place
        called = {}
        # Typer reads the parameters of the function that stands in.
        function = getattr(import_module(f"drcli.cli.commands.{module}"), name)
        stand_in = wraps(function)(lambda **named: called.update(named))
        monkeypatch.setattr(f"drcli.cli.commands.{module}.{name}", stand_in)
        with pytest.raises(SystemExit) as end:
            main(list(arguments))
        return end.value.code, called

    return call


@pytest.mark.parametrize(
    ("line", "ignored", "taken"),
    [
        ("stop-training -f", "-f", {}),
        ("stop-all now", "now", {}),
        ("upload-custom-files -m my_model", "-m my_model", {}),
        ("start-training -m my_model -qw", "-m my_model", {"quiet": True, "wipe": True}),
        ("start-training -w -r 1 -k", "-k", {"worker_log": True, "worker": 1}),
        ("upload-model -fz", "-z", {"force": True}),
        ("upload-model -i -c 7", "-i", {"number": "7"}),
        ("upload-model -I name -b", "-I name", {"best": True}),
        ("upload-model -1Lp other", "", {"increment": True, "local": True, "prefix": "other"}),
        ("logs-sagemaker -f -w 15", "-f", {"wait_s": 15.0}),
        ("logs-robomaker --tail 100", "--tail 100", {"replica": 1}),
        ("start-viewer --resolution 1280x720 -q 75", "--resolution 1280x720", {}),
        ("set-upload-model -c -s name", "-c -s", {"prefix": "name"}),
        ("start-tournament -w -q", "-w", {"race": None, "quiet": True}),
        ("start-tournament -qf race.yaml", "", {"race": None, "quiet": True, "file": "race.yaml"}),
        ("start-tournament -f race.yaml duel", "", {"race": "duel", "file": "race.yaml"}),
        ("list-aws-models -c", "-c", {}),
    ],
)
def test_old_commands_ignore_what_they_do_not_know_with_one_warning(
    words_of, capsys, line, ignored, taken
):
    code, called = words_of(*line.split())

    name = line.partition(" ")[0]
    assert code == 0
    assert capsys.readouterr().err == f"Warning: `dr {name}` ignores {ignored}.\n" * bool(ignored)
    assert {key: called[key] for key in taken} == taken


@pytest.mark.parametrize(
    "line",
    [
        "upload-model --dryrun",
        "upload-model --dry",
        "start-training -wipe",
        "start-training --until-lap-tme 8",
        "stop-training --jsn",
        "evaluate -z",
        "status now",
    ],
)
def test_misspelt_options_and_commands_of_our_own_are_refused(words_of, line):
    code, called = words_of(*line.split())

    assert (code, called) == (2, {})


def test_every_command_of_the_reference_is_known_as_such():
    assert program_names().keys() >= OF_REFERENCE


@pytest.mark.parametrize(
    "words",
    [["analyze", "nothing-here"], ["explain", "xyzzy"], ["status"], ["init", "--preset", "x"]],
)
def test_with_json_a_failure_is_an_object_too(dr, working_folder, capsys, words):
    (working_folder / "run.env").write_text("DR_WORKERS=many\n")

    code = dr(*words, "--json")

    printed = capsys.readouterr()
    told = json.loads(printed.out.splitlines()[-1])
    assert (set(told), told["code"]) == ({"error", "remedy", "code"}, code)
    assert f"Error: {told['error']}" in printed.err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["status", "--jsn"], "--jsn"),
        (["statsu"], "statsu"),
        (["config", "set"], "NAME=VALUE"),
        (["video", "--fps", "many"], "many"),
        (["video", "--size", "1x1"], "1x1"),
        (["--nothing"], "--nothing"),
    ],
)
def test_with_json_a_wrong_command_line_is_an_object_too(dr, working_folder, capsys, words, named):
    code = dr(*words, "--json")

    printed = capsys.readouterr()
    (line,) = printed.out.splitlines()
    told = json.loads(line)
    assert (code, told["code"]) == (2, 2)
    assert named in told["error"]
    assert "--help" in told["remedy"]
    assert named in printed.err


@pytest.mark.parametrize(
    ("words", "way"),
    [
        ("evaluate mine", "`DR_LOCAL_S3_MODEL_PREFIX=mine dr-evaluate`"),
        ("status mine", "`DR_LOCAL_S3_MODEL_PREFIX=mine dr-status`"),
        ("export car mine", "`dr export car -p mine`"),
        ("race run cup mine", "`dr race submit`"),
        ("bench mine", ""),
    ],
)
def test_a_word_too_many_is_answered_with_the_way_to_name_a_model(
    dr, working_folder, capsys, words, way
):
    code = dr(*words.split())

    error = capsys.readouterr().err.splitlines()[-1]
    assert code == 2
    assert "does not take mine." in error
    assert error.endswith(f"{way}." if way else "mine.")


def test_an_old_command_that_ignores_a_word_says_how_to_name_a_model(words_of, capsys):
    words_of("start-training", "mine")

    warning = capsys.readouterr().err
    assert "ignores mine. Name another model in front: `DR_LOCAL_S3_MODEL_PREFIX=mine" in warning


def test_a_wrong_command_line_breaks_between_words(dr, working_folder, monkeypatch):
    screen = _Terminal()
    monkeypatch.setattr(terminal, "err", terminal.Console(file=screen, width=60))
    monkeypatch.setattr(sys, "stderr", screen)

    dr("evaluate", "--checkpoint", "newest-but-one")

    lines = screen.getvalue().splitlines()
    error = lines[next(k for k, line in enumerate(lines) if line.startswith("Error: ")) :]
    assert len(error) > 1
    assert all(len(line) <= 60 for line in error)


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["config", "check"], "DR_WORKERS=many is not"),
        (["reward", "check", "bad.py"], "name 'speeed' is not defined"),
    ],
)
@pytest.mark.parametrize("screen", [True, False])
def test_a_terminal_shows_the_errors_of_a_check_once(
    dr, working_folder, capsys, monkeypatch, words, fault, screen
):
    if words[0] == "config":
        (working_folder / "run.env").write_text("DR_WORKERS=many\n")
    (working_folder / "bad.py").write_text("def reward_function(params):\n    return speeed\n")
    output = _Terminal() if screen else io.StringIO()
    monkeypatch.setenv("COLUMNS", "200")
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", output)
        code = dr(*words)

    errors = capsys.readouterr().err
    assert code == 3
    assert fault in output.getvalue()
    assert ("Error:" in errors) is not screen  # a script may read only one of the two


def test_a_report_of_errors_stays_the_only_object(dr, working_folder, capsys):
    (working_folder / "run.env").write_text("DR_WORKERS=many\n")

    code = dr("config", "check", "--json")

    (line,) = capsys.readouterr().out.splitlines()
    assert code == 3
    assert "error" not in json.loads(line)
