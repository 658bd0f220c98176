"""A command group that loads a command when it is called, so that no call pays for the others."""

from importlib import import_module
from itertools import groupby
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command_from_info, get_group
from typer.models import CommandInfo

from drcli.commands.table import COMMANDS, Command

_BY_NAME = {command.name: command for command in COMMANDS}


class LazyGroup(TyperGroup):
    """The commands of `drcli.commands.table`."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of the table."""
        return list(_BY_NAME)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, loaded; None where there is none."""
        command = _BY_NAME.get(cmd_name)
        return None if command is None else load(command)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands for `dr --help`, from the table alone."""
        for section, commands in groupby(COMMANDS, lambda command: command.section):
            with formatter.section(section):
                formatter.write_dl([(command.name, command.help) for command in commands])


def load(command: Command) -> Any:
    """The command as Typer runs it."""
    module, _, name = command.target.partition(":")
    target = getattr(import_module(f"drcli.commands.{module}"), name)
    if isinstance(target, typer.Typer):
        target.rich_markup_mode = None
        group = get_group(target)
        group.name = command.name
        return group
    return get_command_from_info(
        CommandInfo(name=command.name, callback=target),
        pretty_exceptions_short=False,
        rich_markup_mode=None,
    )
