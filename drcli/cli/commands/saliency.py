"""`dr saliency`."""

from pathlib import Path
from typing import Annotated

import typer

from drcli.base.errors import ProblemsError
from drcli.base.files import refuse_existing, refuse_replacing, safe_name
from drcli.base.installation import lazy_imports
from drcli.cli import evaluation_options as options
from drcli.cli import terminal
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import (
    Replace,
    checkpoint_option,
    in_options,
    models_argument,
    parsed_checkpoint,
    world_option,
)
from drcli.cli.show import show
from drcli.cli.working_folder import working_folder
from drcli.config.value_types import parse_checkpoint
from drcli.model.model_store import ModelStore
from drcli.view.saliency.saliency_options import (
    METHODS,
    MOST_PICTURES,
    SPACINGS,
    TARGETS,
    SaliencyOptions,
)

with lazy_imports():
    from drcli.config import loading
    from drcli.transfer import transfer_buckets
    from drcli.view.saliency import explain_model


def saliency(
    model: Annotated[
        str | None,
        models_argument("MODEL", "Prefix of a model; that of run.env if left out."),
    ] = None,
    checkpoint: Annotated[str | None, checkpoint_option("Explain")] = None,
    file: Annotated[
        Path | None,
        typer.Option("--model", metavar="FILE", help="Explain the policy in this file instead."),
    ] = None,
    metadata: Annotated[
        Path | None,
        typer.Option("--metadata", metavar="FILE", help="Its model_metadata.json."),
    ] = None,
    world: Annotated[
        str | None, world_option("Track to drive on; DR_WORLD_NAME if left out.", "-w")
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE", help="Write the page here."),
    ] = None,
    png: Annotated[
        Path | None,
        typer.Option("--png", metavar="FOLDER", help="Write a picture of each step into this."),
    ] = None,
    pictures: Annotated[
        int,
        typer.Option("-n", "--pictures", metavar="N", min=1, max=MOST_PICTURES, help="How many."),
    ] = 12,
    steps: Annotated[
        str | None,
        typer.Option("--steps", metavar="A,B", help="Explain these steps of the episode."),
    ] = None,
    target: Annotated[
        str,
        typer.Option(
            "--target", metavar="WHAT", help="Explain the action, steering, speed or value."
        ),
    ] = "action",
    methods: Annotated[
        str,
        typer.Option("--method", metavar="A,B", help="Maps: perturbation, hires-cam, grad-cam."),
    ] = ",".join(METHODS),
    spacing: Annotated[
        int,
        typer.Option(
            "--spacing", metavar="PX", help="Grid of the perturbation map: 4, 5, 8, 10 or 20."
        ),
    ] = 8,
    start_position: options.StartPosition = None,
    reverse: options.Reverse = None,
    seed: options.Seed = None,
    force: Replace = False,
) -> None:
    """Show which pixels move the car: one episode, explained picture by picture.

    Drives an episode with the model's likeliest actions, from the start of the evaluation settings
    until a completed lap, a crash or the edge of the track. Then blurs every place of some pictures
    and measures how far the action changes (perturbation), and asks the network where it found
    its evidence (HiResCAM, Grad-CAM). Also shows the probability of each action, the entropy and
    what the critic expects along the lap.

    Writes the page MODEL-saliency.html unless --html or --png says otherwise.

    Example: dr-saliency --checkpoint best --html saliency.html
    """
    if file is not None and (model is not None or checkpoint is not None):
        raise typer.BadParameter("--model explains a file; leave out MODEL and --checkpoint.")
    if metadata is not None and file is None:
        raise typer.BadParameter("--metadata belongs to a file; name that with --model.")
    chosen = parsed_checkpoint(checkpoint)
    question = _question(pictures, steps, target, methods, spacing, seed)
    flags = {"DR_WORLD_NAME": world} if world is not None else {}
    try:
        settings = loading.load_settings(working_folder(), flags=flags)
    except ProblemsError as error:
        raise in_options(error, {"DR_WORLD_NAME": "--world"}, flags) from None
    settings = options.with_options(
        settings, DR_EVAL_START_POSITION=start_position, DR_EVAL_REVERSE_DIRECTION=reverse
    )
    bring_tracks(settings)
    if html is None and png is None:
        subject = file.stem if file is not None else model or settings.model_prefix
        html = Path(f"{safe_name(subject)}-saliency.html")
    if html is not None:
        refuse_replacing(html, force=force)
    if png is not None and (old := next(png.glob("saliency-*.png"), None)) is not None:
        refuse_existing(old, force=force)

    name = None
    with terminal.waiting("Driving an episode and explaining it ..."):
        if file is not None:
            prefix = str(file)
            explained = explain_model.explain_file(settings, file, metadata, question)
        else:
            bucket = transfer_buckets.bucket_to_look_at(settings.transfer, upload=False)
            prefix = settings.model_prefix if model is None else model.rstrip("/")
            wanted = chosen or parse_checkpoint(settings.eval_checkpoint)
            explained, name = explain_model.explain_checkpoint(
                settings, ModelStore(bucket, prefix), wanted, question
            )
        stills = [] if png is None else explain_model.write_stills(png, explained)
        if html is not None:
            explain_model.write_page(html, explained)
    report = explain_model.report_of(explained, prefix, name, html, stills)
    terminal.warn(*report.notes)
    show(report)


def _question(
    pictures: int, steps: str | None, target: str, methods: str, spacing: int, seed: int | None
) -> SaliencyOptions:
    wanted_target = next((each for each in TARGETS if each == target), None)
    if wanted_target is None:
        raise typer.BadParameter(f"--target is one of {', '.join(TARGETS)}, not {target!r}.")
    if spacing not in SPACINGS:
        known = ", ".join(map(str, SPACINGS))
        raise typer.BadParameter(f"--spacing is one of {known}, not {spacing}.")
    named = options.listed(methods)
    if not named or not set(named) <= set(METHODS):
        raise typer.BadParameter(f"--method takes {', '.join(METHODS)}, not {methods!r}.")
    numbers = options.listed(steps)
    if steps is not None and not (numbers and all(_is_step(number) for number in numbers)):
        raise typer.BadParameter(f"--steps takes numbers such as 10,20,30, not {steps!r}.")
    if len(numbers) > MOST_PICTURES:
        raise typer.BadParameter(f"--steps takes at most {MOST_PICTURES} numbers.")
    return SaliencyOptions(
        pictures,
        [int(number) for number in numbers],
        [method for method in METHODS if method in named],
        wanted_target,
        spacing,
        seed or 0,
    )


def _is_step(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 8
