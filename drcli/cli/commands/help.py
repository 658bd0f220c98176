"""`dr help`."""

from typing import Annotated, Any

import typer
import typer.main

from drcli.base.errors import shown
from drcli.cli import command_line, completion
from drcli.cli.options import text_only


@text_only
def explain_command(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[COMMAND]...",
            help="A command, such as status, or race submit.",
            autocompletion=completion.commands,
        ),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="List every command.")] = False,
) -> None:
    """Explain a command: what it does, its options, and an example.

    `dr help race submit` shows what `dr race submit --help` shows.

    Example: dr help race submit
    """
    names = words or []
    command: Any = typer.main.get_command(command_line.application(names))
    command.shows_all = everything
    context = typer.Context(command, info_name="dr", **command.context_settings)
    for name in names:
        if not hasattr(command, "resolve_command"):
            context.fail(f"'{context.command_path}' has no command '{shown(name)}'.")
        _, command, _ = command.resolve_command(context, [name])
        context = typer.Context(command, parent=context, info_name=name, **command.context_settings)
    typer.echo(context.get_help())
