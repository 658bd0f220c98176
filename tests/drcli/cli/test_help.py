"""`dr --help`, `dr help` and `dr version`."""

import ast
import json
import os
import platform
import pty
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import typer.main

import drcli
from drcli import __version__
from drcli.cli.command_line import application
from drcli.cli.command_table import COMMANDS
from drcli.cli.completion import docs_pages

SHOWN = [command for command in COMMANDS if not command.hidden]
GROUPS = ["Start here", "Train", "Look", "Models", "Race and car"]


@pytest.mark.parametrize("line", ["--help", "-h", "", "help"])
def test_help_fits_one_terminal_with_its_prompt(dr, capsys, monkeypatch, line):
    monkeypatch.setenv("COLUMNS", "80")

    dr(*line.split())

    printed = capsys.readouterr()
    lines = (printed.out + printed.err).splitlines()
    assert len(lines) <= 23
    assert max(map(len, lines)) <= 80
    assert [group for group in GROUPS if any(at.lstrip().startswith(group) for at in lines)] == (
        GROUPS
    )


def test_help_names_what_a_racer_uses_and_where_the_rest_is(dr, capsys):
    dr("--help")

    shown = capsys.readouterr().out
    everyday = [command for command in SHOWN if command.everyday]
    assert len(everyday) <= 30
    assert all(f" {command.name} " in shown for command in everyday)
    assert "start-loganalysis" not in shown
    assert "dr --help --all" in shown


@pytest.mark.parametrize(
    "line", ["--help --all", "--all --help", "--all", "help --all", "-h --all"]
)
def test_all_lists_every_command_the_options_and_the_exit_codes(dr, capsys, line):
    code = dr(*line.split())

    words = capsys.readouterr().out.split()
    assert code == 0
    assert [command.name for command in SHOWN if command.name not in words] == []
    assert {"--version", "--quiet", "143"} <= set(words)


@pytest.mark.parametrize(
    ("columns", "line"),
    [("40", "--help"), ("60", "--help"), ("72", "--help"), ("80", "--help --all")],
)
def test_help_is_no_wider_than_the_terminal(dr, capsys, monkeypatch, columns, line):
    monkeypatch.setenv("COLUMNS", columns)

    dr(*line.split())

    assert max(map(len, capsys.readouterr().out.splitlines())) <= int(columns)


@pytest.mark.parametrize(
    "words", ["status", "race", "race submit", "console", "start-viewer", "help", "local-aws"]
)
def test_help_for_a_command_is_what_the_command_says(dr, capsys, words):
    code = dr("help", *words.split())
    helped = capsys.readouterr().out
    dr(*words.split(), "--help")

    assert code == 0
    assert helped == capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("statsu", "No such command 'statsu'. Did you mean 'status'?"),
        ("race sumbit", "No such command 'sumbit'. Did you mean 'submit'?"),
        ("sweep strat", "No such command 'strat'. Did you mean 'start'?"),
        ("status now", "'dr status' has no command 'now'."),
        ("xyzzy", "No such command 'xyzzy'."),
    ],
)
def test_help_for_an_unknown_word_is_one_sentence_with_the_nearest_names(dr, capsys, words, said):
    code = dr("help", *words.split())

    printed = capsys.readouterr()
    assert (code, printed.out) == (2, "")
    assert printed.err.endswith(f"Error: {said}\n")


def test_the_version_names_what_a_report_of_a_fault_needs(dr, capsys):
    assert dr("version") == 0
    shown = capsys.readouterr().out
    assert dr("version", "--json") == 0

    told = json.loads(capsys.readouterr().out)
    assert list(told) == ["version", "python", "torch", "mujoco", "platform"]
    assert (told["version"], told["python"]) == (__version__, platform.python_version())
    assert all(value in shown for value in told.values())


@pytest.mark.parametrize("former", [c for c in COMMANDS if c.same_as], ids=lambda c: c.name)
def test_a_former_name_takes_all_that_its_command_takes(former):
    words = [word for word in former.same_as.split() if not word.startswith("-")]
    command = typer.main.get_command(application(words))
    for word in words:
        command = command.commands[word]
    alias = typer.main.get_command(application([former.name])).commands[former.name]

    def names(single):
        return {parameter.name for parameter in single.params}

    added = {"browser"} if former.name == "update-viewer" else set()
    asked = {"upload"} if former.same_as.endswith("--upload") else set()
    assert names(command) - names(alias) <= added | asked


@pytest.mark.parametrize(
    "page", ["hyperparameters", "docs/hyperparameters.md", "hyperparameters.md#x", "lessons/README"]
)
def test_a_page_is_shown_however_a_message_names_it(dr, capsys, page):
    dr("docs", page)

    assert capsys.readouterr().out.startswith("# ")


def test_a_page_opens_in_a_pager_on_a_terminal():
    other_end, own = pty.openpty()
    with os.fdopen(other_end, "rb", buffering=0) as screen:
        call = "from drcli.cli.app import main; main(['docs', 'tracks'])"
        environment = {**os.environ, "PAGER": "cat", "TERM": "xterm"}
        environment.pop("NO_COLOR", None)
        shown = b""
        with subprocess.Popen(
            [sys.executable, "-c", call], stdin=own, stdout=own, stderr=own, env=environment
        ) as process:
            os.close(own)
            with suppress(OSError):  # the other end is closed
                while read := screen.read(4096):
                    shown += read

    assert process.returncode == 0, shown
    assert b"Tracks" in shown
    assert b"# Tracks" not in shown


def told_by(path):
    """Texts of a module: all but comments and docstrings, except those that are help."""
    tree = ast.parse(path.read_text("utf-8"))
    bare = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    if path.parent.name == "commands":
        first = [node.body[0] for node in tree.body if isinstance(node, ast.FunctionDef)]
        bare -= {line.value for line in first if isinstance(line, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in bare:
            yield node.value


def test_messages_name_pages_as_a_working_folder_can_show_them():
    texts = [text for path in Path(drcli.__file__).parent.rglob("*.py") for text in told_by(path)]
    named = {page for text in texts for page in re.findall(r"`dr docs ([a-z-]+)`", text)}

    assert named <= set(docs_pages())
    assert len(named) > 8
    assert [text for text in texts if re.search(r"\bdocs/[\w-]+\.md", text)] == []


def test_the_pages_are_listed_and_an_unknown_one_is_refused(dr, capsys):
    dr("docs")
    code = dr("docs", "hyperparameter")

    printed = capsys.readouterr()
    assert re.search(r"^tracks +Tracks$", printed.out, re.MULTILINE)
    assert code == 3
    assert "Did you mean hyperparameters?" in printed.err


@pytest.mark.parametrize(
    ("word", "pages"),
    [
        ("lesson-2", "lessons/2-loophole"),
        ("spot machines", "spot"),
        ("hyperparmeters", "hyperparameters"),
    ],
)
def test_a_page_is_found_by_a_word_of_its_name_or_title(dr, capsys, word, pages):
    code = dr("docs", word)

    printed = capsys.readouterr()
    assert code == 3
    assert f"Did you mean {pages}?" in printed.err
