"""Writes docs/commands.md from the commands themselves."""

from itertools import groupby
from typing import Any

import typer.main
from commands_texts import HEAD, KEYS_HEAD, REFERENCE_HEAD, TOPICS
from drfc_commands import REFERENCE, Row
from report_keys import REPORTS, keys_of

from drcli.checks.explain.explain_texts import EXIT_CODES
from drcli.cli.command_line import application
from drcli.cli.command_table import COMMANDS, program_names

_PROGRAMS = {name: program for program, name in program_names().items()}
"""Name of the installed program of each command."""

_LISTED = [command for command in COMMANDS if not command.hidden and not command.same_as]

_EXAMPLE = "Example: "


def document() -> str:
    """The text of docs/commands.md."""
    parts = [HEAD, _overview(), _exit_codes(), *TOPICS, REFERENCE_HEAD, _reference()]
    parts += ["## Every command", *(_section(command.name) for command in _LISTED)]
    parts += [KEYS_HEAD, *(_keys(report, names) for report, names in REPORTS.items())]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _overview() -> str:
    """All commands by group, a line each, and the former names."""
    parts = []
    for group, commands in groupby(_LISTED, lambda command: command.group):
        lines = [
            f"| [`{_PROGRAMS[c.name]}`](#{_PROGRAMS[c.name]}) | {_cell(c.help)} |" for c in commands
        ]
        parts.append("\n".join([f"| {group} | |", "| --- | --- |", *lines]))
    former = [f"| `{_PROGRAMS[c.name]}` | `dr {c.same_as}` |" for c in COMMANDS if c.same_as]
    parts.append("\n".join(["| other name | same as |", "| --- | --- |", *former]))
    return "\n\n".join(parts)


def _exit_codes() -> str:
    rows = [f"| {code} | {meaning} |" for code, meaning in EXIT_CODES.items()]
    return "\n".join(["## Exit codes", "", "| code | meaning |", "| --- | --- |", *rows])


def _reference() -> str:
    return "\n".join(
        [
            "| DeepRacer-for-Cloud | drcli | verdict | notes |",
            "| --- | --- | --- | --- |",
            *(_reference_line(row) for row in REFERENCE),
        ]
    )


def _reference_line(row: Row) -> str:
    here = f"`{row.program}`" if row.program else ""
    return f"| `{row.name}` | {here} | {row.verdict} | {_cell(row.why)} |"


def _section(name: str) -> str:
    program = _PROGRAMS[name]
    group: Any = typer.main.get_command(application([name]))
    loaded = group.commands[name]
    if not hasattr(loaded, "commands"):
        return f"### {program}\n\n{_manual(loaded)}"
    parts = [f"### {program}\n\n{_text(loaded)}"]
    parts += [
        f"#### {program} {part}\n\n{_manual(command)}" for part, command in loaded.commands.items()
    ]
    return "\n\n".join(parts)


def _manual(command: Any) -> str:
    """What `--help` says: its text, arguments and options, and an example."""
    parts = [_text(command)]
    rows = [_parameter(parameter) for parameter in command.params if not parameter.hidden]
    if rows:
        parts.append("\n".join(["| option | meaning |", "| --- | --- |", *rows]))
    parts.append("\n".join(["```sh", command.help.partition(_EXAMPLE)[2].strip(), "```"]))
    return "\n\n".join(parts)


def _text(command: Any) -> str:
    """The help of a command without its example."""
    return _escaped(str(command.help).partition(_EXAMPLE)[0].strip())


def _parameter(parameter: Any) -> str:
    """A line of the table. Asks for no more than every version of Typer tells of a parameter."""
    value = parameter.metavar or parameter.name.upper().replace("_", "-")
    if parameter.param_type_name == "argument":
        names = f"`{value}`"
    else:
        tail = "" if parameter.is_flag else f" {value}"
        names = ", ".join(f"`{name}{tail}`" for name in parameter.opts)
    return f"| {_cell(names)} | {_cell(parameter.help or '')} |"


def _keys(report: str, names: tuple[str, ...]) -> str:
    """The keys of a report, below the commands that print it."""
    programs = ", ".join(f"`dr-{name}`" for name in names)
    rows = [f"| `{key}` | {_cell(meaning)} |" for key, meaning in keys_of(report)]
    return "\n".join([f"**{programs}**", "", "| key | meaning |", "| --- | --- |", *rows])


def _cell(text: str) -> str:
    """Text as it may stand in a table."""
    return _escaped(" ".join(text.split())).replace("|", "\\|")


def _escaped(text: str) -> str:
    """Angle brackets would be taken for HTML, except within backticks."""
    pieces = text.split("`")
    pieces[::2] = [piece.replace("<", "&lt;") for piece in pieces[::2]]
    return "`".join(pieces)
