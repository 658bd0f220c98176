"""Names of the reference behind which nothing is built, as their caller meets them."""

import json

import pytest

from drcli.cli.command_table import COMMANDS

NAMES = [c.name for c in COMMANDS if c.module == "not_built"]


@pytest.mark.parametrize("name", [name for name in NAMES if not name.startswith("stop-")])
def test_what_is_not_built_says_so_in_a_line_and_what_to_use_now(dr, working_folder, capsys, name):
    code = dr(name)

    printed = capsys.readouterr()
    error, remedy = printed.err.splitlines()
    assert code == 7
    assert printed.out == ""
    assert error.startswith("Error: ")
    assert remedy.startswith("  Try: ")
    assert "`" in remedy


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("stop-")])
def test_ending_what_cannot_run_is_no_failure(dr, working_folder, capsys, name):
    code = dr(name)

    assert code == 0
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("stop-")])
def test_ending_what_cannot_run_tells_scripts_so_too(dr, working_folder, capsys, name):
    code = dr(name, "--json")

    assert code == 0
    assert json.loads(capsys.readouterr().out) == {"stopped": [], "server": False}


@pytest.mark.parametrize(
    "command",
    [
        ["start-viewer", "-w", "640", "-h", "480", "-q", "90", "-t", "/x", "-b", "f", "-p", "8"],
        ["view-stream", "-h", "480"],
    ],
)
def test_flags_of_the_reference_are_no_wrong_command_line(dr, working_folder, capsys, command):
    assert dr(*command) == 7


def test_their_help_can_still_be_read(dr, capsys):
    code = dr("start-viewer", "--help")

    assert code == 0
    assert "The viewer is not available" in capsys.readouterr().out
