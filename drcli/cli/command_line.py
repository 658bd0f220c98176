"""The Typer application, which loads only the called command."""

import inspect
import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import wraps
from importlib import import_module
from itertools import groupby, islice
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
from typer.core import TyperCommand, TyperGroup

from drcli import __version__
from drcli.base.errors import shown
from drcli.base.processes import Interrupted
from drcli.cli import completion, terminal
from drcli.cli.command_table import COMMANDS, OF_REFERENCE, Command
from drcli.cli.terminal import NARROWEST

EPILOG = """Every command is also a program: dr-status is dr status. Begin with `dr init`.
`dr help COMMAND` explains a command. Scripts may go on with the other names.
`dr completion install` makes the Tab key complete commands.

\b
Exit codes:
    0  done
    1  answered no, not running, no log yet, or an internal error
    2  wrong command line
    3  wrong setting or file, already running, or model exists or missing
    4  the bucket cannot be reached, read or written
    5  a worker died
    6  the training failed and cannot continue
    7  not available in this version, not installed, or broken
    8  another machine has taken over the model
    9  another machine trains the model (--no-wait)
   10  the training is complete, but upload or import at its end failed
   75  interrupted, can be resumed
  130  interrupted (Ctrl-C)
  143  stopped (SIGTERM, or the terminal was closed)
"""

HELP_COLUMNS = 80
"""Typer's own minimum is 50 columns."""

_BESIDE_COLUMNS = 70
"""From here on, names of groups stand beside the commands instead of above them."""

LONGEST_COMPARED = 80
PROGRAM = "dr"
TAKES_ANY = {
    "ignore_unknown_options": True,
    "allow_extra_args": True,
    "allow_interspersed_args": False,
    "help_option_names": ["--help"],  # -h is the height of the reference's viewer
}


def application(arguments: Sequence[str]) -> typer.Typer:
    """The application for one call: the first word that is not an option names the command."""
    columns = shutil.get_terminal_size().columns
    folded = {"terminal_width": columns - 1} if NARROWEST <= columns < HELP_COLUMNS else {}
    app = typer.Typer(
        name=PROGRAM,
        cls=_Overview,
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
            group = _with_default(command.default) if command.default else _Group
            app.add_typer(target, cls=group, name=command.name, short_help=command.help)
        else:
            app.command(
                command.name,
                cls=_OfReference if f"dr-{command.name}" in OF_REFERENCE else _Command,
                short_help=command.help,
                hidden=command.hidden,
                context_settings=TAKES_ANY if command.takes_any else None,
            )(target)
    return app


def load(command: Command) -> Any:
    module, name = command.place
    target = getattr(import_module(f"drcli.cli.commands.{module}"), name)
    if not isinstance(target, typer.Typer):
        return target if command.takes_any else _with_options(target)
    for single in target.registered_commands:
        if single.callback is not None:
            # Typer would cut a sentence after 45 letters.
            single.short_help = (inspect.getdoc(single.callback) or "").partition("\n\n")[0]
            single.callback = _with_options(single.callback)
            single.cls = _Command
    return target


class _Reading:
    """Takes a value of the right type as it is: Typer would load pydantic, which is slow."""

    def __init__(self, typers: Callable[[], Any]) -> None:
        self._typers = typers

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value as the command gets it.

        Raises:
            BadParameter: It is wrong.
        """
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
        try:
            return self._typers().coerce(value, param=param, ctx=ctx)
        except typer.BadParameter as bad:
            bad.message = _in_plain_words(bad, str(value))
            raise


def _in_plain_words(bad: Any, value: str) -> str:
    for fault in getattr(bad.__cause__, "errors", list)():
        context = fault.get("ctx", {})
        kind = fault["type"]
        if kind.startswith("int_"):
            return f"'{shown(value)}' is not a whole number."
        if kind == "float_parsing":
            return f"'{shown(value)}' is not a number."
        if kind == "greater_than_equal":
            return f"'{shown(value)}' must be at least {context['ge']}."
        if kind == "less_than_equal":
            return f"'{shown(value)}' must be at most {context['le']}."
        if kind == "value_error":
            return str(context["error"])
    return str(bad.message)


def _read(parameter: Any) -> Any:
    # Older versions of Typer do without pydantic.
    if hasattr(parameter, "get_runtime_param") and "get_runtime_param" not in vars(parameter):
        reading = _Reading(parameter.get_runtime_param)
        parameter.get_runtime_param = lambda: reading
    return parameter


class _Command(TyperCommand):
    def get_params(self, ctx: Any) -> Any:
        return [_read(parameter) for parameter in super().get_params(ctx)]


class _OfReference(_Command):
    """Ignores words that it does not know, with one warning, so that old scripts go on.

    There, most of these commands read none of their words, and earlier versions had other options.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        kept, ignored = _known_words(self.get_params(ctx), args)
        rest = super().parse_args(ctx, kept)
        if ignored and not ctx.resilient_parsing:
            names = not any(word.startswith("-") for word in ignored)
            way = _way_to_name(ctx, ignored[0]) if names else ""
            terminal.warn(f"`dr {self.name}` ignores {shown(' '.join(ignored))}.{way}")
        return rest


def _known_words(parameters: Sequence[Any], words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The words that these parameters take, and the others.

    The first has misspelt options too, for the parser to refuse them.
    """
    options = {name: each for each in parameters for name in (*each.opts, *each.secondary_opts)}
    arguments = [each for each in parameters if each.param_type_name == "argument"]
    kept: list[str] = []
    ignored: list[str] = []
    coming = iter(words)
    for word in coming:
        if word == "--":
            kept += [word, *coming]
        elif not word.startswith("-") or word == "-":
            taken = arguments and (arguments[0].type_descriptor.annotation is str or word.isdigit())
            if taken and arguments[0].nargs == 1:
                arguments.pop(0)
            (kept if taken else ignored).append(word)
        else:
            known, unknown, last = _split_options(word, options)
            kept += known
            ignored += unknown
            if last is not None and not last.is_flag:
                kept += islice(coming, 1)
    return kept, ignored


def _split_options(
    word: str, options: Mapping[str, Any]
) -> tuple[list[str], list[str], Any | None]:
    """What is known of an option or of letters behind one dash; who takes the next word."""
    name, equals, _ = word.partition("=")
    known = unknown = ""
    last = None
    if word.startswith("--"):
        if name in options:
            return [word], [], None if equals else options[name]
        unknown = word
    else:
        for place, letter in enumerate(word[1:], 1):
            option = options.get(f"-{letter}")
            if option is None:
                unknown = f"{unknown or '-'}{letter}"
                continue
            known = f"{known or '-'}{letter}"
            if not option.is_flag:
                known += word[place + 1 :]
                last = option if place + 1 == len(word) else None
                break
    meant = f"--{name.lstrip('-')}"
    if unknown and len(meant) > 4:  # shorter ones are letters, such as -bf
        begun = [each for each in options if each.startswith(meant)]
        if begun or get_close_matches(meant, options, cutoff=0.8):
            return [word], [], None
    return [known] * bool(known), [unknown] * bool(unknown), last


class _Group(TyperGroup):
    def get_params(self, ctx: Any) -> Any:
        return [_read(parameter) for parameter in super().get_params(ctx)]


def _with_default(default: str) -> type[_Group]:
    class Group(_Group):
        default_command = default

        def parse_args(self, ctx: Any, args: list[str]) -> Any:
            if not args:
                args = [] if self.no_args_is_help else [default]
            elif args[0] not in self.commands and args[0] not in _HELP:
                args = [default, *args]
            return super().parse_args(ctx, args)

    return Group


_HELP = ("-h", "--help")


_UsageError: Any = typer.BadParameter.__base__
"""Typer has it in several places, depending on its version."""


_EXTRA = re.compile(r"unexpected extra argument\S* \((.*)\)")
_OF_THE_SETTINGS = (
    *("start-training", "stop-training", "status", "attach", "logs", "analyze"),
    *("evaluate", "start-evaluation", "stop-evaluation"),
)
"""They act on the model that the settings name."""


def _way_to_name(ctx: Any, word: str) -> str:
    """How to name a model, for a command that was called with a word that it does not take."""
    name, command, above = shlex.quote(shown(word)), ctx.command, ctx.parent
    if command.name in _OF_THE_SETTINGS and above.parent is None:
        return f" Name another model in front: `DR_LOCAL_S3_MODEL_PREFIX={name} dr-{command.name}`."
    option = next((p.opts[0] for p in command.params if p.metavar == "PREFIX"), None)
    if option:
        return f" Name a model with `{ctx.command_path} {option} {name}`."
    others = above.command.commands if above.parent is not None else {}
    taking = [n for n, each in others.items() if any(p.name == "model" for p in each.params)]
    named = ", ".join(f"`{above.command_path} {n}`" for n in taking)
    return f" A model is taken by {named}." if named else ""


@contextmanager
def _refused(words: Sequence[str]) -> Iterator[None]:
    """A wrong command line, in whole words; with --json an object too, read or not yet."""
    try:
        yield
    except _UsageError as error:
        ctx, message = error.ctx, error.format_message()
        if type(error).__name__ == "NoArgsIsHelpError":
            raise
        called = PROGRAM if ctx is None else ctx.command_path
        if ctx is not None and (extra := _EXTRA.search(message)):
            first = extra[1].partition(" ")[0]
            message = f"`{called}` does not take {extra[1]}.{_way_to_name(ctx, first)}"
        if "--json" in words:
            remedy = f"`{called} --help` shows what it takes."
            terminal.emit_failure(message, remedy, error.exit_code)
        error.format_message = lambda: terminal.in_lines(message, after=len("Error: "))
        raise


class _Overview(_Group):
    """Lists what a racer uses, on one screen; with --all every command, by group."""

    shows_all = False

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        self.shows_all = "--all" in args  # --help is answered before the other options are read
        with _refused(args):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with _refused(ctx.args):
            return super().invoke(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        word = args[0]
        if word not in self.commands and not word.startswith("-"):
            likely = ", ".join(f"'{name}'" for name in _likely(word))
            hint = f" Did you mean {likely}?" if likely else ""
            ctx.fail(f"No such command '{shown(word)}'.{hint}")
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        if self.shows_all:
            super().format_help(ctx, formatter)
            return
        self.format_usage(ctx, formatter)
        if formatter.width < _BESIDE_COLUMNS:
            _write_groups(formatter, _EVERYDAY)
            return
        formatter.write_paragraph()
        rows = [
            ("" if position else group, command)
            for group, commands in groupby(_EVERYDAY, lambda command: command.group)
            for position, command in enumerate(commands)
        ]
        formatter.write_dl([(f"{group:13} {c.name}", c.help) for group, c in rows], col_max=40)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        _write_groups(formatter, [c for c in _LISTED if not c.same_as])
        with formatter.section("Other names"):
            formatter.write_dl([(c.name, c.same_as) for c in _LISTED if c.same_as])


_LISTED = [command for command in COMMANDS if not command.hidden]
_EVERYDAY = [command for command in COMMANDS if command.everyday]


def _write_groups(formatter: Any, listed: Sequence[Command]) -> None:
    for group, commands in groupby(listed, lambda command: command.group):
        with formatter.section(group):
            formatter.write_dl([(command.name, command.help) for command in commands])


def _likely(word: str) -> list[str]:
    names = [command.name for command in _LISTED]
    typed = word[:LONGEST_COMPARED].casefold().removeprefix("dr-")
    if typed in names:
        return [typed]
    close = get_close_matches(typed, names)
    return close or [name for name in names if len(typed) > 2 and typed in name][:4]


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dr {__version__}")
        raise typer.Exit


def _show_all(ctx: typer.Context, wanted: bool) -> None:
    if wanted:
        typer.echo(ctx.get_help())
        raise typer.Exit


def _be_quiet(wanted: bool) -> None:
    terminal.quiet = terminal.quiet or wanted


def _print_json(wanted: bool) -> None:
    terminal.as_json = terminal.as_json or wanted


def _flag(text: str, callback: Callable[[bool], None], *names: str) -> Any:
    return typer.Option(*names, help=text, callback=callback, expose_value=False)


_QUIET = "Print only results, warnings and errors."
_Quiet = Annotated[bool, _flag(_QUIET, _be_quiet, "-q", "--quiet")]
_LongQuiet = Annotated[bool, _flag(_QUIET, _be_quiet, "--quiet")]
_Json = Annotated[
    bool, _flag("Print a JSON object as the last line of stdout.", _print_json, "--json")
]


def _global_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
    everything: Annotated[
        bool,
        typer.Option("--all", callback=_show_all, is_eager=True, help="List every command."),
    ] = False,
    quiet: _Quiet = False,
) -> None:
    """Options that belong to no command."""


def _with_options(function: Callable[..., None]) -> Callable[..., None]:
    """Adds --json where a report is printed, and -q, or only --quiet where -q is taken."""
    signature = inspect.signature(function)
    quiet = _LongQuiet if "-q" in _option_names(signature) else _Quiet
    offered = {} if hasattr(function, "text_only") else {"as_json": _Json}
    offered["quiet"] = quiet
    options = {name: each for name, each in offered.items() if name not in signature.parameters}

    @wraps(function)
    def command(*args: Any, **named: Any) -> None:
        try:
            function(*args, **{name: named[name] for name in named if name not in options})
        except KeyboardInterrupt:  # typer would end without a word
            raise Interrupted("Interrupted.", remedy="") from None

    kind = inspect.Parameter.KEYWORD_ONLY
    added = [
        inspect.Parameter(name, kind, default=False, annotation=annotation)
        for name, annotation in options.items()
    ]
    parameters = [*signature.parameters.values(), *added]
    vars(command)["__signature__"] = signature.replace(parameters=parameters)
    return command


def _option_names(signature: inspect.Signature) -> set[str]:
    names: set[str] = set()
    for parameter in signature.parameters.values():
        for fact in getattr(parameter.annotation, "__metadata__", ()):
            # Within Annotated, Typer takes the first name for the default value.
            first = getattr(fact, "default", None)
            names.update(getattr(fact, "param_decls", None) or ())
            if isinstance(first, str):
                names.add(first)
    return names


def _not_called() -> None:
    """Stands for a command that was not called."""
