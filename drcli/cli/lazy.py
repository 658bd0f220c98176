"""A command group that loads a command when it is called, so that no call pays for the others."""

import shutil
from collections.abc import Callable
from difflib import get_close_matches
from importlib import import_module
from itertools import groupby
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
from typer.core import TyperGroup
from typer.main import get_command_from_info, get_group
from typer.models import CommandInfo

from drcli.base import verbosity
from drcli.base.problems import shown
from drcli.cli.table import COMMANDS, Command

TAKES_ANY = {
    "ignore_unknown_options": True,
    "allow_extra_args": True,
    "allow_interspersed_args": False,
    "help_option_names": ["--help"],  # -h is the height of the reference's viewer
}
"""What makes a command leave its options to somebody else."""

NARROWEST, HELP_COLUMNS = 40, 80
"""Columns between which help is folded; the library's own least is 50."""

QUIET_HELP = "Only results, warnings and failures."

_BY_NAME = {command.name: command for command in COMMANDS}


class LazyGroup(TyperGroup):
    """The commands of `drcli.cli.table`."""

    def make_context(self, *args: Any, **extra: Any) -> Any:
        """The context of a call, whose help fits a narrow terminal too."""
        columns = shutil.get_terminal_size().columns
        if NARROWEST <= columns < HELP_COLUMNS:
            extra["terminal_width"] = columns - 1
        return super().make_context(*args, **extra)

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of the table."""
        return [command.name for command in COMMANDS if not command.hidden]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, loaded; None where there is none."""
        command = _BY_NAME.get(cmd_name)
        if command is None:
            return None
        loaded = load(command)
        if not command.takes_any:
            for single in (loaded, *getattr(loaded, "commands", {}).values()):
                _spare(single.get_help_option(ctx))
                for parameter in single.params:
                    _spare(parameter)
        return loaded

    def get_help_option(self, ctx: Any) -> Any:
        """The option --help."""
        return _spare(super().get_help_option(ctx))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the first word names; the likely ones are told where there is none."""
        word = args[0]
        if word not in _BY_NAME and not word.startswith("-"):
            likely = _likely(word)
            hint = f" Did you mean {' or '.join(likely)}?" if likely else ""
            ctx.fail(f"No such command '{shown(word)}'.{hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands for `dr --help`, from the table alone."""
        listed = [command for command in COMMANDS if not command.hidden]
        for section, commands in groupby(listed, lambda command: command.section):
            with formatter.section(section):
                formatter.write_dl([(command.name, command.help) for command in commands])


def load(command: Command) -> Any:
    """The command as Typer runs it."""
    loaded = _load(command)
    if not command.takes_any:
        for single in getattr(loaded, "commands", {"": loaded}).values():
            _let_be_quiet(single)
    return loaded


class _AsItIs:
    """How a parameter takes its value: untouched where that is of the right type already.

    To look at it, Typer loads pydantic, which takes a tenth of a second at every start.
    """

    def __init__(self, look: Callable[[], Any]) -> None:
        """Begin.

        Args:
            look: Gives what Typer takes values with.
        """
        self._look = look

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value as the command gets it; a wrong one is refused."""
        wanted = param.type_descriptor.annotation
        several = param.multiple or param.nargs != 1
        if value is None and not several:
            return None
        if wanted == list[str] and several and not isinstance(value, str):
            return list(value or ())
        if isinstance(wanted, type) and isinstance(value, wanted):
            return value
        if get_origin(wanted) is Literal and value in get_args(wanted):
            return value
        return self._look().coerce(value, param=param, ctx=ctx)


def _spare(parameter: Any) -> Any:
    """The parameter, which does without pydantic where it can."""
    # Older versions of Typer use no pydantic.
    if hasattr(parameter, "get_runtime_param") and hasattr(parameter, "type_descriptor"):
        plain = _AsItIs(parameter.get_runtime_param)
        parameter.get_runtime_param = lambda: plain
    return parameter


def _likely(word: str) -> list[str]:
    """Commands that somebody may have meant, the likeliest first."""
    names = [command.name for command in COMMANDS if not command.hidden]
    if word.removeprefix("dr-") in names:
        return [word.removeprefix("dr-")]
    typed = word[:80].casefold()
    same = get_close_matches(typed, names, n=1, cutoff=0.9)
    close = same or get_close_matches(typed, names, n=3, cutoff=0.7)
    return close or [name for name in names if len(word) > 2 and word.casefold() in name][:4]


def _let_be_quiet(command: Any) -> None:
    """Give a command -q, as far as it has no such option of its own."""

    def no_words(
        quiet: Annotated[
            bool,
            typer.Option("-q", "--quiet", help=QUIET_HELP, callback=_quiet, expose_value=False),
        ] = False,
    ) -> None:
        pass

    taken = {spelling for parameter in command.params for spelling in parameter.opts}
    if not taken & {"-q", "--quiet"}:
        (option,) = _from_function(CommandInfo(name="", callback=no_words)).params
        command.params.append(option)


def _quiet(wanted: bool) -> None:
    verbosity.quiet = verbosity.quiet or wanted


def _load(command: Command) -> Any:
    module, _, name = command.target.partition(":")
    target = getattr(import_module(f"drcli.cli.commands.{module}"), name)
    if isinstance(target, typer.Typer):
        target.rich_markup_mode = None
        group = get_group(target)
        group.name = command.name
        for single in group.commands.values():
            # The library's own would end in three dots after 45 letters.
            single.short_help = " ".join(str(single.help).partition("\n\n")[0].split())
        return group
    return _from_function(
        CommandInfo(
            name=command.name,
            callback=target,
            context_settings=TAKES_ANY if command.takes_any else None,
        )
    )


def _from_function(info: CommandInfo) -> Any:
    return get_command_from_info(info, pretty_exceptions_short=False, rich_markup_mode=None)
