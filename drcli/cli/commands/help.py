"""`dr help`."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.main

from drcli.base.errors import SettingsError, closest, shown
from drcli.base.installation import lazy_imports
from drcli.cli import command_line, completion, terminal
from drcli.cli.options import text_only

with lazy_imports():
    from rich import markdown

    from drcli.config import presets


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


@text_only
def docs(
    page: Annotated[
        str | None,
        typer.Argument(
            metavar="PAGE",
            help="Name of a page, such as hyperparameters.",
            autocompletion=completion.docs_pages,
        ),
    ] = None,
) -> None:
    """List the pages of the documentation, or show one.

    On a terminal it opens in a pager (q leaves it); a pipe gets the page as it was written.

    Example: dr docs hyperparameters
    """
    pages = completion.docs_pages()
    folder = presets.docs_folder()
    if page is None:
        titles = {name: _title(folder / f"{name}.md") for name in pages}
        width = max(map(len, pages))
        terminal.write("".join(f"{name:{width}}  {title}\n" for name, title in titles.items()))
        return
    wanted = page.removeprefix("./").removeprefix("docs/").partition("#")[0].removesuffix(".md")
    if wanted not in pages:
        what = f"There is no page called {shown(page)}."
        raise SettingsError(what, remedy=_pages_like(wanted, pages))
    text = (folder / f"{wanted}.md").read_text("utf-8")
    if not (terminal.is_live() and terminal.out.is_terminal):
        terminal.write(text)
        return
    os.environ.setdefault("LESS", "-R")
    with terminal.out.pager(styles=True):
        terminal.out.print(markdown.Markdown(text))


def _pages_like(wanted: str, pages: Sequence[str]) -> str:
    folder, words = presets.docs_folder(), wanted.casefold().replace("-", " ")
    texts = {name: f"{name} {_title(folder / f'{name}.md')}" for name in pages}
    found = [name for name, text in texts.items() if words in text.casefold().replace("-", " ")]
    found = found[:6] if words else []
    found = found or [name for name in [closest(wanted, pages, cutoff=0.75)] if name]
    start = f"Did you mean {' or '.join(found)}? " if found else ""
    return f"{start}`dr docs` lists all pages; first-lap is the one to begin with."


def _title(path: Path) -> str:
    return path.read_text("utf-8").partition("\n")[0].removeprefix("#").strip()
