"""Commands that raise names in run.env."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.base.report import counted
from drcli.cli import completion, prompts, terminal
from drcli.cli.options import (
    Delimiter,
    Force,
    checkpoint_option,
    parsed_checkpoint,
    prefix_option,
    wipe_option,
    world_option,
)
from drcli.cli.show import show
from drcli.cli.working_folder import settings, working_folder

with lazy_imports():
    from drcli.config import editing
    from drcli.run import increment
    from drcli.transfer import upload


def increment_training(
    force: Force = False,
    wipe: Annotated[bool, wipe_option("Delete everything under the new model prefix.")] = False,
    prefix: Annotated[str | None, prefix_option("Name of the new model.")] = None,
    delimiter: Delimiter = None,
    checkpoint: Annotated[str | None, checkpoint_option("Start with", "--checkpoint")] = None,
    world: Annotated[str | None, world_option("Train on this track (DR_WORLD_NAME).")] = None,
    reward: Annotated[
        Path | None,
        typer.Option("--reward", metavar="FILE", help="Replace reward_function.py by this file."),
    ] = None,
    hyperparameter: Annotated[
        list[str] | None,
        typer.Option(
            "--hyperparameter",
            metavar="KEY=VALUE",
            help="Change a value in hyperparameters.json; can be given again.",
        ),
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Change another setting, such as a stop condition; can be given again.",
            autocompletion=completion.assignments,
        ),
    ] = None,
    max_iterations: Annotated[
        int | None,
        typer.Option(
            "--max-iterations",
            min=0,
            metavar="N",
            help="Finish after N updates (DR_TRAIN_MAX_ITERATIONS).",
        ),
    ] = None,
    description: Annotated[
        str | None,
        typer.Option("--description", metavar="TEXT", help="Say what the new model is."),
    ] = None,
) -> None:
    """Make the next training start a new model from this model's weights.

    Changes run.env and keeps a copy as run.env.bak: the current model becomes the pretrained one,
    and the number at the end of its name goes up by one. A name without a number gets -1. The last
    checkpoint counts unless --checkpoint or DR_LOCAL_S3_PRETRAINED_CHECKPOINT chooses another.

    Everything is checked before anything is written. Files in custom_files/ that change are kept as
    NAME.bak too. The number of actions, the network and the sensors must stay as they are.

    Example: dr-increment-training -f --checkpoint first-lap --hyperparameter lr=0.0001
    """
    others = list(setting or ())
    if max_iterations is not None:
        others.append(f"DR_TRAIN_MAX_ITERATIONS={max_iterations}")
    overrides = increment.Overrides(
        parsed_checkpoint(checkpoint), world, reward, hyperparameter or (), others, description
    )
    loaded = settings()
    planned = increment.plan_increment(
        loaded, prefix=prefix, delimiter=delimiter, wiping=wipe, overrides=overrides
    )
    step = planned.step
    _announce(step.file, step.before, step.after)
    for name, value in step.settings.items():
        terminal.say(f"{name}={value}")
    for path in step.files:
        terminal.say(f"{path} will be written.")
    prompts.agree("Are you sure?", yes=force)
    if step.wipes:
        prompts.agree(f"Delete everything at s3://{step.bucket}/{step.after}?", yes=force)
    step = increment.make_increment(planned, loaded.storage)
    show(step)
    for path in step.files:
        terminal.say(f"Wrote {path}")
    _done(step.file, step.backup, "dr-start-training", "train the new model", step.files)


def increment_upload_model(
    force: Force = False,
    wipe: Annotated[bool, wipe_option("Delete everything under the new name first.")] = False,
    prefix: Annotated[str | None, prefix_option("Use this name for the next upload.")] = None,
    delimiter: Delimiter = None,
) -> None:
    """Give the next upload a new name: raise the number at the end of DR_UPLOAD_S3_PREFIX.

    Changes run.env and keeps a copy as run.env.bak. A name without a number gets -1.

    Example: dr-increment-upload-model -f
    """
    planned = upload.plan_upload_increment(
        settings(), prefix=prefix, delimiter=delimiter, wiping=wipe
    )
    step = planned.step
    _announce(step.file, step.before, step.after)
    if step.wiped:
        place = f"s3://{planned.settings.upload_s3_bucket}/{step.after}"
        terminal.warn(f"{counted(step.wiped, 'file')} at {place} will be deleted.")
    prompts.agree("Are you sure?", yes=force)
    upload.make_upload_increment(planned)
    show(step)
    _done(step.file, step.backup, "dr-upload-model", "upload the model there")


@dataclass(frozen=True)
class UploadName:
    """The name of the next upload."""

    file: Annotated[str, "The file that was edited."]
    before: Annotated[str, "The old prefix."]
    after: Annotated[str, "The new prefix."]
    target: Annotated[str, "The whole address."]


def set_upload_model(
    prefix: Annotated[str, typer.Argument(metavar="PREFIX", help="Name of the next upload.")],
) -> None:
    """Choose the name of the next upload: writes DR_UPLOAD_S3_PREFIX to run.env.

    Example: dr-set-upload-model team/fast-car-1
    """
    folder, before = working_folder(), settings().upload_s3_prefix
    edit = editing.set_values(folder, {"DR_UPLOAD_S3_PREFIX": prefix}, file="run.env")
    terminal.warn(*edit.warnings)
    after = settings()
    place = f"s3://{after.upload_s3_bucket}/{after.upload_s3_prefix}"
    file = str(folder / edit.changes[0].file)
    report = UploadName(file, before, after.upload_s3_prefix, place)
    terminal.emit(report, f"The next upload goes to {place} (written to {file}).")


def _announce(file: str, before: str, after: str) -> None:
    terminal.say(f"Configuration file {file} will be updated.")
    terminal.say(f"Incrementing model from {before} to {after}")


def _done(file: str, backup: str, command: str, purpose: str, files: Sequence[str] = ()) -> None:
    terminal.say("Done.")
    kept = [(f"{path}.bak", path) for path in files if Path(f"{path}.bak").is_file()]
    undo = " && ".join(shlex.join(["cp", *pair]) for pair in [(backup, file), *kept])
    terminal.suggest([(command, purpose), (undo, "undo this change")])
