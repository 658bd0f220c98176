"""Every report on terminals of several widths and kinds, in a pipe, and in JSON."""

import io
import json
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
import typer.main
from report_keys import REPORTS, keys_of
from rich.cells import cell_len

from drcli.base.errors import SettingsError
from drcli.cli import terminal
from drcli.cli.command_line import application
from drcli.cli.command_table import COMMANDS

from .conftest import DROA_ID, MODEL, TRACK

WIDTHS = [40, 60, 80, 200]

CALLS = {
    "start-training": "",
    "stop-training": "training",
    "start-worker --join s3://bucket/model": "is complete",
    "sweep start sweep.yaml --dry-run": "pace-03",
    "sweep start sweep.yaml": "* best; its model is pace-02",
    "sweep show pace": "stopped early",
    "sweep list": "pace-02",
    "increment-training -f": "starts with the weights of",
    "evaluate": "laps",
    "evaluate --robust": "Robust score",
    "evaluate --laps 3 --against last": "may be chance",
    "video lap.csv --gif": "Video of 1250.40 s",
    "video --knobs": "DR_SIM_BLUR",
    "evaluate --models team/*": "Train on",
    "evaluate --worlds reinvent_base": "Best on",
    "evaluate --loop": "2 rounds, 1 failed",
    "race create Another": "Best of 3 laps.",
    "race list": "reinvent_base",
    "race show cup": "not qualified",
    "race edit cup --laps 4": "not qualified",
    "race submit cup": "Submitted checkpoint 8",
    "race withdraw cup 000000ad -f": "Bob",
    "race move cup 000000ad 1": "Dan",
    "race restart cup 000000ac": "Cem",
    "race run cup": "0:12.345",
    "race run cup -q": "process 4242",
    "race stop cup": "Stopped the queue",
    "race open cup --closes 2h": "Open for submissions.",
    "race close cup": "Closed for submissions.",
    "race export cup --csv cup.csv --html cup.html": "Page: cup.html",
    "race delete cup -f": "Deleted race cup",
    "start-tournament duel": "0:12.345",
    "start-tournament duel -q": "process 4242",
    "status": "training episodes completed a lap",
    "journal": "(restart 1)",
    "analyze": "Snaking",
    "analyze compare a b": "more than chance",
    "start-loganalysis": "file://",
    "url-loganalysis": "file://",
    "logs-loganalysis": "",
    "explain lr": "Shipped value: 0.001",
    "spot watch --once": "terminate",
    "spot create-base racing -y": "Made racing in",
    "spot create my-run --bucket a-bucket -y": "Started my-run in",
    "spot add-access my-run 203.0.113.7": "may reach port 22",
    "spot subscribe my-run me@example.com": "Amazon has sent a mail",
    "spot list": "until ",
    "spot prices": "<5%",
    "spot status my-run": "training episodes completed a lap",
    "spot console my-run --no-open": "http://127.0.0.1:8100/",
    "spot cost my-run": "at least 1.26 USD",
    "spot stop my-run": "is whole.",
    "spot delete my-run -y": "Removed my-run.",
    "attach": "",
    "summary": "DR_RUN_ID",
    "version": "mujoco",
    "find-sagemaker": "4243",
    "find-robomaker": "4243",
    "get-robomaker-stats": "steps/s",
    "send-message hello": "Sent to",
    "upload-model -f": "Uploaded",
    "increment-upload-model -f": "The next upload goes to",
    "download-model -f -s s3://uploads/model -t model": "Downloaded",
    "import -f model_30.pb -t model": "DR_SIM_CAR=low-grip",
    "export tf-checkpoint": "Verified: ",
    "export droa": "Verified: ",
    "export pb": "greatest difference",
    "export onnx": "greatest difference",
    "export tflite": "greatest difference",
    "export openvino --fp16": "greatest difference",
    "history list": "(gone)",
    "history show 000001ab": "began with",
    "history compare 000001ab 000002ff": "batch_size",
    "history tree 000001ab": "reinvent_base",
    "history forget 000001ab -f": "began",
    "list-models": "(training)",
    "list-checkpoints": "Not reached: three-laps.",
    "note add words": "Description",
    "note list": "at checkpoint 12",
    "note edit 1 words": "wider kerbs",
    "note remove 1": "wider kerbs",
    "delete-model old/* -f": "Deleted",
    "tidy -f": "Deleted",
    f"set-upload-model {MODEL}": "The next upload goes to",
    "export car": "of a drive on",
    "upload-car-zip -f": "of a drive on",
    "car login --car 10.0.0.5": "Logged in",
    "car logout --car 10.0.0.5": "was not kept",
    "car upload a-file.tar.gz --car 10.0.0.5": "has installed",
    "car list --car 10.0.0.5": "is not connected",
    "car load a-model --car 10.0.0.5": "has loaded",
    "car start -f --car 10.0.0.5": "has stopped after 12 s",
    "car stop --car 10.0.0.5": "has stopped",
    "car speed 30 --car 10.0.0.5": "30 %",
    "car status --car 10.0.0.5": "frames/s",
    "car config --car 10.0.0.5": "servo, diffdrive",
    "car check --car 10.0.0.5": "looks upright",
    "car latency --car 10.0.0.5": "DR_SIM_LATENCY=0.042",
    "droa login": "Signed in to",
    "droa logout": "Deleted the temporary keys",
    "droa list": "READY",
    f"droa show {DROA_ID} -v --summary": "episodes",
    "droa import --from model": "It is ready.",
    f"droa download {DROA_ID}": "Downloaded TRAINING_LOGS",
    f"droa delete {DROA_ID} -f": "is deleting",
    "droa races": "Spring",
    f"droa submit {DROA_ID} Spring": "best lap 9.950 s",
    "init elsewhere": "",
    "config show": "DR_WORLD_NAME=reinvent_base",
    "config show DR_WORLD_NAME DR_HOST_X": "Allowed: ",
    "config check --settings": "Settings: 0 errors",
    "config set DR_WORKERS=1": "DR_WORKERS=1",
    "config preset physical": "DR_SIM_GLARE=0.6",
    "action-space generate --angles 3": "6 actions.",
    "action-space from-lap lap.csv -k 2": "From the fastest of 1 clean lap:",
    "action-space from-histogram lap.csv": "They cover 99%",
    "action-space show --file model_metadata.json": "2 m/s",
    "validate": "V-21",
    "doctor": "Try: ",
    "bench": "training steps/s",
    "support-bundle": "Left out: ",
    "upload-custom-files": "copied to",
    "download-custom-files": "copied to",
    "update": "",
    "url": "http",
    "completion install bash": "",
    "stop-all": "Stopped the local S3 server",
    "stop-evaluation": "Stopped the evaluation",
    "console start": "http://127.0.0.1:8100/",
    "console restart": "http://127.0.0.1:8100/",
    "console open --no-open": "http://127.0.0.1:8100/",
    "console status": "http://127.0.0.1:8100/",
    "console stream": "/stream?topic=/racecar/deepracer/kvs_stream",
    "console stop": "Stopped the console",
    "metrics start": "http://127.0.0.1:6006/",
    "metrics stop": "Stopped TensorBoard",
    "saliency": "middle left",
    "stop-loganalysis": "",
    "tracks list": "own",
    "tracks show reinvent_base": "waypoints",
    "tracks line reinvent_base": "FASTEST_LINE = [",
    "tracks limit reinvent_base": "The limit of the car",
    f"tracks add {TRACK}.csv": "waypoints",
    "tracks generate mine --seed 3": "waypoints",
    f"tracks fetch {TRACK}": "waypoints",
    "tracks fetch --all": "tracks/",
    "reward check": "steady lap",
    "reward examples": "milestones",
    "reward examples speed": "def reward_function(params):",
    "reward plot": "Picture",
    "reward compare a.py b.py": "Correlation",
}
"""What follows `dr`, and a word of what it prints. The first words name the command."""

REFUSING = ("validate", "reward check", "doctor")
"""What reports an error here, and so exits with its code."""


VARIANTS = {
    "analyze compare",
    "evaluate --robust",
    "evaluate --laps",
    "evaluate --models",
    "evaluate --worlds",
    "evaluate --loop",
    "video --knobs",
    "start-evaluation -q",
    "race run -q",
    "start-tournament -q",
    "export car --check",
    "tracks fetch --all",
    "spot create --dry-run",
    "sweep start --dry-run",
    "spot delete --keep-bucket",
}
"""Commands with an option that makes them print another report."""


ADDRESSES = ("console stream", "url", "start-loganalysis", "url-loganalysis")
"""Commands that print addresses."""

UNFOLDED = (*ADDRESSES, "reward examples speed")
"""What cannot be pasted in two pieces: addresses and code."""


class Terminal(io.StringIO):
    """Standard output as a terminal, or as a pipe."""

    def __init__(self, *, attached: bool) -> None:
        super().__init__()
        self._attached = attached

    def isatty(self) -> bool:
        return self._attached


@pytest.fixture
def printed(paper_reports, working_folder, dr, monkeypatch):
    """Lines that a command prints on a terminal of so many columns; None stands for a pipe."""
    files = {path: path.read_bytes() for path in working_folder.iterdir()}

    def lines(words: str, columns: int | None) -> list[str]:
        _restore(working_folder, files)
        paper_reports()
        terminal = Terminal(attached=columns is not None)
        monkeypatch.setenv("COLUMNS", str(columns or 40))
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", terminal)
            code = dr(*words.split())
        assert code == (SettingsError.code if words in REFUSING else 0)
        return terminal.getvalue().splitlines()

    return lines


@pytest.fixture
def environment(monkeypatch):
    """Lets the consoles find a variable, and none of those that would outdo it."""

    def put(variable: str) -> None:
        for doubtful in ("NO_COLOR", "FORCE_COLOR", "TERM"):
            monkeypatch.delenv(doubtful, raising=False)
        monkeypatch.setenv(*variable.split("="))
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", Terminal(attached=True))
            patch.setattr(sys, "stderr", Terminal(attached=True))
            consoles = {"out": terminal.fresh(), "err": terminal.fresh(stderr=True)}
        for name, made in consoles.items():
            monkeypatch.setattr(terminal, name, made)

    return put


def _restore(folder: Path, files: Mapping[Path, bytes]) -> None:
    """Undo what the last command has done in a folder."""
    for path in folder.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    for path, data in files.items():
        path.write_bytes(data)


def is_variant(words: str, name: str) -> bool:
    """Whether words call a variant: its command, and somewhere its option."""
    group, _, option = name.rpartition(" ")
    return words.startswith(name) or (
        f"{words} ".startswith(f"{group} ") and option in words.split()
    )


@pytest.mark.parametrize("words", CALLS)
def test_a_report_fits_every_terminal_and_has_no_colours_where_there_are_none(
    printed, environment, capfd, words
):
    for columns in WIDTHS:
        lines = printed(words, columns)

        if words not in UNFOLDED:
            assert [line for line in lines if cell_len(line) > columns] == [], columns
        assert [line for line in lines if line != line.rstrip()] == [], columns
        assert [line for line in lines if "\N{HORIZONTAL ELLIPSIS}" in line] == [], columns
        assert CALLS[words] in " ".join(lines), columns
    for variable in ("NO_COLOR=1", "TERM=dumb"):
        environment(variable)

        lines = printed(words, 80)

        assert "\x1b" not in "".join(lines) + capfd.readouterr().err, variable


@pytest.mark.parametrize("words", ["list-models", "tracks list", "config show", "url", "summary"])
def test_a_pipe_gets_each_row_in_one_line_however_long(printed, words):
    lines = printed(words, None)

    name = TRACK if words == "tracks list" else MODEL
    assert any(name in line for line in lines)
    assert [line for line in lines if line != line.rstrip()] == []


def test_an_address_stays_in_one_piece_on_a_narrow_terminal(printed):
    lines = printed("url", 40)

    assert f"  s3://bucket/{MODEL}/" in lines


@pytest.mark.parametrize("words", ["list-models", "tracks list", "config show", "status"])
def test_a_narrow_terminal_gets_every_letter_of_a_name(printed, words):
    lines = printed(words, 40)

    name = TRACK if words == "tracks list" else MODEL
    assert name in "".join(line.strip() for line in lines)


def test_another_terminal_gets_colours(printed, environment):
    environment("TERM=xterm")

    assert "\x1b[" in "".join(printed("status", 80))


@pytest.mark.parametrize("words", CALLS)
def test_a_program_gets_the_documented_keys(paper_reports, dr, capsys, words):
    dr(*words.split(), "--json")

    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    called = next((name for name in VARIANTS if is_variant(words, name)), command(words))
    [report] = [report for report, names in REPORTS.items() if called in names]
    assert list(told) == [key for key, _ in keys_of(report) if "." not in key]


# The choices of `dr url` are one word, as the library writes them.
@pytest.mark.parametrize("name", [c.name for c in COMMANDS if not c.takes_any and c.name != "url"])
def test_help_fits_a_narrow_terminal(dr, capsys, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "40")

    dr(name, "--help")

    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if len(line) > 40] == []


def test_the_help_of_a_group_tells_of_its_commands_in_whole_sentences(dr, capsys):
    dr("tracks", "--help")

    told = " ".join(capsys.readouterr().out.split())
    assert "fetch Download a community track into the folder DR_TRACKS_DIR." in told


def test_the_report_of_every_command_is_documented():
    documented = {name for names in REPORTS.values() for name in names}

    assert documented - VARIANTS == NAMES


def test_every_command_that_reports_is_looked_at():
    assert {command(words) for words in CALLS} == NAMES


def reporting() -> set[str]:
    """Names of all commands that know --json, with those of their groups."""
    names = set()
    for command in (command for command in COMMANDS if not command.same_as):
        loaded = typer.main.get_command(application([command.name])).commands[command.name]
        for part, single in getattr(loaded, "commands", {"": loaded}).items():
            if any("--json" in parameter.opts for parameter in single.params):
                names.add(f"{command.name} {part}".strip())
    return names


NAMES = reporting()


def command(words: str) -> str:
    """The name of the command that is called, with that of its group."""
    return next(name for name in NAMES if f"{words} ".startswith(f"{name} "))
