"""`dr note`."""

from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.options import prefix_option
from drcli.cli.show import show
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.transfer.model_notes import NoteList

with lazy_imports():
    from drcli.transfer import model_notes


app = typer.Typer(
    no_args_is_help=True,
    help="Write notes about a model, and read them.\n\n"
    "Notes are kept with the model in the bucket; lists, status and journal show them, and copies "
    'of the model have them too.\n\nExample: dr-note add "Wider kerbs, slower in the hairpin"',
)

_Prefix = Annotated[str | None, prefix_option("A note of this model instead.")]
_Text = Annotated[str, typer.Argument(metavar="TEXT", help="What the note says.")]
_Number = Annotated[
    int, typer.Argument(metavar="N", min=0, help="Its number in the list; 0 for the description.")
]


@app.command()
def add(text: _Text, prefix: _Prefix = None) -> None:
    """Add a note to the model of run.env, also while it is training.

    Example: dr-note add "Wider kerbs, slower in the hairpin"
    """
    _show(model_notes.write_note(settings(), prefix, text))


@app.command("list")
def list_notes(prefix: _Prefix = None) -> None:
    """List the notes of a model.

    Example: dr-note list -p team/model-1
    """
    _show(model_notes.list_notes(settings(), prefix))


@app.command()
def edit(number: _Number, text: _Text, prefix: _Prefix = None) -> None:
    """Replace the text of a note; number 0 is the description of the model.

    Example: dr-note edit 0 "Fast, but leaves the track"
    """
    _show(model_notes.rewrite_note(settings(), prefix, number, text))


@app.command()
def remove(number: _Number, prefix: _Prefix = None) -> None:
    """Remove a note; the later ones move up.

    Example: dr-note remove 2
    """
    _show(model_notes.delete_note(settings(), prefix, number))


def _show(found: "NoteList") -> None:
    terminal.warn(*found.damaged)
    show(found)
