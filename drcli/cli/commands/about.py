"""`dr help` and `dr version`."""

import platform
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import typer
import typer.main

from drcli import __version__
from drcli.base.errors import shown
from drcli.cli import command_line, completion, console
from drcli.cli.options import AsJson
from drcli.model.run_metadata import installed_versions


@dataclass(frozen=True)
class Versions:
    """What a training depends on.

    Attributes:
        version: Of drcli.
        python: Of Python.
        torch: Of PyTorch; null if it is not installed, as are others.
        mujoco: Of MuJoCo.
        platform: Operating system and processor.
    """

    version: str
    python: str
    torch: str | None
    mujoco: str | None
    platform: str


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


def version(as_json: AsJson = False) -> None:
    """Show the versions of drcli, Python, torch and MuJoCo, and the platform.

    Example: dr version --json
    """
    libraries = installed_versions(["torch", "mujoco"])
    report = Versions(
        __version__, platform.python_version(), **libraries, platform=platform.platform()
    )
    rows = {"drcli" if key == "version" else key: value for key, value in asdict(report).items()}
    lines = [f"{name:9} {value or 'not installed'}" for name, value in rows.items()]
    console.emit(report, "\n".join(lines), as_json=as_json)
