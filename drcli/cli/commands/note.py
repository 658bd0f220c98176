"""`dr note`."""

from typing import TYPE_CHECKING, Annotated

import typer

from drcli.cli import console
from drcli.cli.options import AsJson, prefix_option
from drcli.cli.show import show
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.transfer.model_notes import NoteList

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
def add(text: _Text, prefix: _Prefix = None, as_json: AsJson = False) -> None:
    """Add a note to the model of run.env, also while it is training.

    Example: dr-note add "Wider kerbs, slower in the hairpin"
    """
    from drcli.transfer.model_notes import write_note

    _show(write_note(settings(), prefix, text), as_json=as_json)


@app.command("list")
def list_notes(prefix: _Prefix = None, as_json: AsJson = False) -> None:
    """List the notes of a model.

    Example: dr-note list -p team/model-1
    """
    from drcli.transfer import model_notes

    _show(model_notes.list_notes(settings(), prefix), as_json=as_json)


@app.command()
def edit(number: _Number, text: _Text, prefix: _Prefix = None, as_json: AsJson = False) -> None:
    """Replace the text of a note; number 0 is the description of the model.

    Example: dr-note edit 0 "Fast, but leaves the track"
    """
    from drcli.transfer.model_notes import rewrite_note

    _show(rewrite_note(settings(), prefix, number, text), as_json=as_json)


@app.command()
def remove(number: _Number, prefix: _Prefix = None, as_json: AsJson = False) -> None:
    """Remove a note; the later ones move up.

    Example: dr-note remove 2
    """
    from drcli.transfer.model_notes import delete_note

    _show(delete_note(settings(), prefix, number), as_json=as_json)


def _show(found: "NoteList", *, as_json: bool) -> None:
    console.warn(*found.damaged)
    show(found, as_json=as_json)
