"""`dr export tf-checkpoint` and `dr export droa`: forms that other trainings continue from."""

import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.cli import candidates, console
from drcli.cli.options import (
    AsJson,
    best_option,
    checkpoint_choice,
    checkpoint_option,
    prefix_option,
)
from drcli.cli.views import export_view
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.models.export_model import Selection

_Best = Annotated[bool, best_option("Export")]
_Number = Annotated[
    int | None,
    checkpoint_option("Export"),
]
_Prefix = Annotated[str | None, prefix_option("Export this model instead.")]
_Replace = Annotated[bool, typer.Option("-f", "--force", help="Replace files at the target.")]
_Local = Annotated[
    bool, typer.Option("-L", "--local", help="The bucket of --out is at the local server.")
]


def tf_checkpoint(
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            metavar="PLACE",
            help="A folder, or s3://bucket/prefix; NAME-tf-checkpoint if left out.",
        ),
    ] = None,
    best: _Best = False,
    number: _Number = None,
    prefix: _Prefix = None,
    local: _Local = False,
    force: _Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write a TensorFlow checkpoint, from which the reference simulator evaluates and trains on.

    The folder is laid out like a model of DeepRacer-for-Cloud. Names and shapes of all variables
    are compared with the reference's before anything is written. Exports the last checkpoint unless
    -b or -c chooses another.

    Example: dr-export tf-checkpoint -b --out s3://bucket/team/model-1
    """
    from drcli.models.export_checkpoint import export_checkpoint, read_checkpoint_export
    from drcli.models.write_export import export_target

    loaded, selection = settings(), _selection(best, number, prefix)
    source = selection.prefix or loaded.model_prefix
    place = out or f"{source.rpartition('/')[2]}-tf-checkpoint"
    target = export_target(loaded, place, source, local=local, force=force)
    exported = read_checkpoint_export(loaded, selection)
    console.say(exported.source.chosen.line)
    report = export_checkpoint(exported, target, partial(console.progress, unit="bytes"))
    console.emit(report, export_view.reference(report), as_json=as_json)


def droa(
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            metavar="PLACE",
            help="A folder, beside which NAME.tar.gz is written; a file that ends with .tar.gz; or "
            "s3://bucket/prefix. NAME-droa if left out.",
        ),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            metavar="TRACK",
            help="Name this track instead of the model's.",
            autocompletion=candidates.worlds,
        ),
    ] = None,
    best: _Best = False,
    number: _Number = None,
    prefix: _Prefix = None,
    local: _Local = False,
    force: _Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write the folder and the archive that DeepRacer on AWS imports.

    Track and direction come from the model's training_params.yaml. Exports the last checkpoint
    unless -b or -c chooses another.

    Example: dr-export droa -b --out my-model
    """
    from drcli.models.export_droa import export_droa, read_droa_export
    from drcli.models.write_export import export_target, is_url, usable_archive

    loaded, selection = settings(), _selection(best, number, prefix)
    source = selection.prefix or loaded.model_prefix
    place = out or f"{source.rpartition('/')[2]}-droa"
    target, archive = None, None
    if place.endswith((".tar.gz", ".tgz")) and not is_url(place):
        archive = usable_archive(Path(place).expanduser(), force=force)
    else:
        target = export_target(loaded, place, source, local=local, force=force)
        if target.folder is not None:
            archive = target.folder.with_name(f"{target.folder.name}.tar.gz")
            archive = usable_archive(archive, force=force)
    exported = read_droa_export(loaded, selection, world)
    console.say(exported.source.chosen.line)
    report = export_droa(exported, target, archive, partial(console.progress, unit="bytes"))
    console.emit(report, export_view.reference(report), as_json=as_json)
    if target is not None and target.folder is not None:
        import_it = f"droa-import-model --from {shlex.quote(place)}"
        console.suggest([(import_it, "import it into DeepRacer on AWS")])


def _selection(best: bool, number: int | None, prefix: str | None) -> "Selection":
    from drcli.models.export_model import Selection

    return Selection(checkpoint_choice(best, number), prefix)
