"""`dr export tf-checkpoint` and `dr export droa`."""

import shlex
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from drcli.base.replaceable import refuse_existing, safe_name
from drcli.cli import console
from drcli.cli.export_options import (
    ExportBest,
    ExportNumber,
    ExportPrefix,
    selection,
)
from drcli.cli.options import AsJson, Replace, World
from drcli.cli.views import export_view
from drcli.cli.working_folder import settings

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
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    local: _Local = False,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write a TensorFlow checkpoint, from which the reference simulator evaluates and trains on.

    The folder is laid out like a model of DeepRacer-for-Cloud. Names and shapes of all variables
    are compared with the reference's before anything is written. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export tf-checkpoint --out s3://bucket/team/model-1
    """
    from drcli.models.export_checkpoint import export_checkpoint, read_checkpoint_export
    from drcli.models.write_export import export_target

    loaded, chosen = settings(), selection(best, number, prefix)
    source = chosen.prefix or loaded.model_prefix
    place = out or f"{safe_name(source)}-tf-checkpoint"
    target = export_target(loaded, place, source, local=local, force=force)
    exported = read_checkpoint_export(loaded, chosen)
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
    world: World = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    local: _Local = False,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write the folder and the archive that DeepRacer on AWS imports.

    Track and direction come from the model's training_params.yaml. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export droa --out my-model
    """
    from drcli.models.export_droa import export_droa, read_droa_export
    from drcli.models.write_export import export_target, is_url

    loaded, chosen = settings(), selection(best, number, prefix)
    source = chosen.prefix or loaded.model_prefix
    place = out or f"{safe_name(source)}-droa"
    target, archive = None, None
    if place.endswith((".tar.gz", ".tgz")) and not is_url(place):
        archive = Path(place).expanduser()
    else:
        target = export_target(loaded, place, source, local=local, force=force)
        if target.folder is not None:
            archive = target.folder.with_name(f"{target.folder.name}.tar.gz")
    if archive is not None:
        refuse_existing(archive, force=force)
    exported = read_droa_export(loaded, chosen, world)
    report = export_droa(exported, target, archive, partial(console.progress, unit="bytes"))
    console.emit(report, export_view.reference(report), as_json=as_json)
    if target is not None and target.folder is not None:
        import_it = f"droa-import-model --from {shlex.quote(place)}"
        console.suggest([(import_it, "import it into DeepRacer on AWS")])
