"""Writes docs/commands.md from the commands themselves."""

from dataclasses import dataclass
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

_EXAMPLE = "Example: "


def document() -> str:
    """The text of docs/commands.md."""
    groups = _groups()
    parts = [HEAD, _overview(groups), _exit_codes(), *TOPICS, REFERENCE_HEAD, _reference()]
    parts += ["## Every command", *(_section(group) for group in groups)]
    parts += [KEYS_HEAD, *(_keys(report, names) for report, names in REPORTS.items())]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _overview(groups: "list[_Group]") -> str:
    """All commands by section, a line each."""
    anchors = {name: group.anchor for group in groups for name in group.programs}
    parts = []
    shown = [command for command in COMMANDS if not command.hidden]
    for section, commands in groupby(shown, lambda command: command.section):
        lines = [
            f"| [`{_PROGRAMS[c.name]}`](#{anchors[_PROGRAMS[c.name]]}) | {_cell(c.help)} |"
            for c in commands
        ]
        parts.append("\n".join([f"| {section} | |", "| --- | --- |", *lines]))
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


@dataclass
class _Group:
    """Commands that say the same of themselves, and so share a section."""

    programs: list[str]
    loaded: list[Any]

    @property
    def anchor(self) -> str:
        """The anchor of the section."""
        return "-".join(self.programs)


def _groups() -> list[_Group]:
    groups: dict[str, _Group] = {}
    for command in COMMANDS:
        if command.hidden:
            continue
        loaded = _loaded(command.name)
        group = groups.setdefault(_text(loaded), _Group([], []))
        group.programs.append(_PROGRAMS[command.name])
        group.loaded.append(loaded)
    return list(groups.values())


def _loaded(name: str) -> Any:
    """A command as Typer runs it."""
    group: Any = typer.main.get_command(application([name]))
    return group.commands[name]


def _section(group: _Group) -> str:
    title = f"### {', '.join(group.programs)}"
    subcommands: dict[str, Any] = getattr(group.loaded[0], "commands", {})
    if not subcommands:
        return f"{title}\n\n{_manual(group.loaded)}"
    parts = [f"{title}\n\n{_text(group.loaded[0])}"]
    parts += [
        f"#### {group.programs[0]} {name}\n\n{_manual([command])}"
        for name, command in subcommands.items()
    ]
    return "\n\n".join(parts)


def _manual(commands: list[Any]) -> str:
    """What `--help` says: its text, arguments and options, and an example."""
    parts = [_text(commands[0])]
    rows = [_parameter(parameter) for parameter in commands[0].params if not parameter.hidden]
    if rows:
        parts.append("\n".join(["| option | meaning |", "| --- | --- |", *rows]))
    examples = [command.help.partition(_EXAMPLE)[2].strip() for command in commands]
    parts.append("\n".join(["```sh", *dict.fromkeys(examples), "```"]))
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
