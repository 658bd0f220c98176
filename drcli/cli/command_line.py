"""The Typer application: every command of the table, of which only the called one is loaded."""

import inspect
import os
import shutil
from collections.abc import Callable, Sequence
from functools import wraps
from importlib import import_module
from itertools import groupby
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from drcli import __version__
from drcli.cli import completion, console
from drcli.cli.command_table import COMMANDS, Command

EPILOG = """Every command is also a program: dr-status is dr status. Begin with `dr init`.
`dr completion install` makes the Tab key complete commands.

\b
Exit codes:
    0  done
    1  answered no, not running, no log yet, or an internal error
    2  wrong command line
    3  wrong setting, parameter file or reward function
    4  the bucket cannot be reached, read or written
    5  a worker died
    6  the training failed and cannot continue
    7  not available in this version, or not installed
    8  another machine has taken over the model
  130  interrupted (Ctrl-C)
  143  stopped (SIGTERM)
"""

NARROWEST, HELP_COLUMNS = 40, 80
"""Help is folded at the edge of terminals of these widths; Typer's own minimum is 50 columns."""

TAKES_ANY = {
    "ignore_unknown_options": True,
    "allow_extra_args": True,
    "allow_interspersed_args": False,
    "help_option_names": ["--help"],  # -h is the height of the reference's viewer
}
"""Lets a command pass on, or ignore, options that it does not know."""


def application(arguments: Sequence[str]) -> typer.Typer:
    """The application for one call with these words after `dr`.

    The first word that is not an option names the command. The modules of all others are not
    loaded.
    """
    columns = shutil.get_terminal_size().columns
    folded = {"terminal_width": columns - 1} if NARROWEST <= columns < HELP_COLUMNS else {}
    app = typer.Typer(
        name="dr",
        cls=_Sections,
        help="Train, watch and race DeepRacer models on this machine.",
        epilog=EPILOG,
        no_args_is_help=True,
        add_completion=completion.QUESTION in os.environ,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], **folded},
    )
    app.callback()(_global_options)
    called = next((word for word in arguments if not word.startswith("-")), "")
    for command in COMMANDS:
        target = load(command) if command.name == called else _not_called
        if isinstance(target, typer.Typer):
            app.add_typer(target, cls=_Group, name=command.name, short_help=command.help)
        else:
            app.command(
                command.name,
                cls=_Command,
                short_help=command.help,
                hidden=command.hidden,
                context_settings=TAKES_ANY if command.takes_any else None,
            )(target)
    return app


def load(command: Command) -> Any:
    """The function or Typer application behind a command, with -q unless it takes any option."""
    module, name = command.place
    target = getattr(import_module(f"drcli.cli.commands.{module}"), name)
    if not isinstance(target, typer.Typer):
        return target if command.takes_any else _with_quiet(target)
    for single in target.registered_commands:
        if single.callback is not None:
            # Typer would cut a sentence after 45 letters.
            single.short_help = (inspect.getdoc(single.callback) or "").partition("\n\n")[0]
            single.callback = _with_quiet(single.callback)
            single.cls = _Command
    return target


def _with_default(option: Any) -> Any:
    """The option --help, False when it is not given. For None, Typer would load pydantic."""
    if option is not None:
        option.default = False
    return option


class _Command(TyperCommand):
    def get_help_option(self, ctx: Any) -> Any:
        return _with_default(super().get_help_option(ctx))


class _Group(TyperGroup):
    def get_help_option(self, ctx: Any) -> Any:
        return _with_default(super().get_help_option(ctx))


class _Sections(_Group):
    """The group of all commands, whose help lists them by section."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands for `dr --help`."""
        listed = [command for command in COMMANDS if not command.hidden]
        for section, commands in groupby(listed, lambda command: command.section):
            with formatter.section(section):
                formatter.write_dl([(command.name, command.help) for command in commands])


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dr {__version__}")
        raise typer.Exit


def _be_quiet(wanted: bool) -> None:
    console.quiet = console.quiet or wanted


_Quiet = Annotated[
    bool,
    typer.Option(
        "-q",
        "--quiet",
        help="Print only results, warnings and errors.",
        callback=_be_quiet,
        expose_value=False,
    ),
]


def _global_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
    quiet: _Quiet = False,
) -> None:
    """Options that belong to no command."""


def _with_quiet(function: Callable[..., None]) -> Callable[..., None]:
    """The function of a command with the option -q, unless it has a parameter `quiet`."""
    signature = inspect.signature(function)
    if "quiet" in signature.parameters:
        return function

    @wraps(function)
    def command(*args: Any, quiet: bool = False, **named: Any) -> None:
        function(*args, **named)

    kind = inspect.Parameter.KEYWORD_ONLY
    quiet = inspect.Parameter("quiet", kind, default=False, annotation=_Quiet)
    parameters = [*signature.parameters.values(), quiet]
    vars(command)["__signature__"] = signature.replace(parameters=parameters)
    return command


def _not_called() -> None:
    """Stands for a command that was not called."""
