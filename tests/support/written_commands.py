"""Checks that a command line in a text is one that our programs understand."""

import re
import shlex
from typing import Any

import typer.main

from drcli.cli.command_line import application
from drcli.cli.command_table import program_names

ASSIGNMENT = re.compile(r"^[A-Z][A-Z0-9_]*=\S*$")


def problem_of(line: str) -> str:
    """Why a line would be refused; empty if it would not, or if it calls no program of ours.

    Looks at the words only: names of commands, options, and how many arguments there are.
    """
    words = shlex.split(line, comments=True)
    while words and ASSIGNMENT.match(words[0]):
        words.pop(0)
    if not words:
        return ""
    programs = program_names()
    if words[0] == "dr":
        words = words[1:]
    elif words[0] in programs:
        words = [programs[words[0]], *words[1:]]
    elif words[0].startswith(("dr-", "droa-")):
        return f"{words[0]} is not a program"
    else:
        return ""
    if not words or words[0].startswith("-"):
        return ""
    words = words[
        : next((k for k, word in enumerate(words) if word in "|&;><" or word == "&&"), None)
    ]
    group: Any = typer.main.get_command(application([words[0]]))
    command = group.commands.get(words[0])
    if command is None:
        return f"{words[0]} is not a command"
    rest = words[1:]
    while rest and hasattr(command, "commands"):
        if rest[0] in ("-h", "--help"):
            return ""
        if rest[0] not in command.commands:
            default = getattr(command, "default_command", "")
            if not default:
                return f"{words[0]} has no command {rest[0]}"
            command = command.commands[default]
            break
        command, rest = command.commands[rest[0]], rest[1:]
    options = {name: each for each in command.params for name in each.opts}
    return _unknown_option(rest, options, takes_any=bool(command.ignore_unknown_options))


def _unknown_option(words: list[str], options: dict[str, Any], *, takes_any: bool) -> str:
    for word in words:
        name = word.split("=")[0]
        if takes_any or not name.startswith("-") or name in ("-", "-h", "--help"):
            continue
        if name in options:
            continue
        short = not name.startswith("--")
        if short and all(f"-{letter}" in options for letter in name[1:]):
            continue
        return f"there is no option {name}"
    return ""
