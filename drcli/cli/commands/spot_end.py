"""`dr-spot stop` and `dr-spot delete`."""

from dataclasses import dataclass
from typing import Annotated

import typer

from drcli.base.errors import SettingsError
from drcli.cli import console, prompts
from drcli.cli.options import AsJson
from drcli.cli.spot_options import Profile, Region, StackName, Yes, account
from drcli.cli.views import spot_view


@dataclass(frozen=True)
class DeletedBase:
    """A base stack that was deleted.

    Attributes:
        stack: Name of the stack.
        bucket: Name of the bucket.
        objects: Number of objects that were deleted with the bucket.
        bucket_kept: Whether the bucket stays.
    """

    stack: str
    bucket: str
    objects: int
    bucket_kept: bool


def stop(
    stack: StackName,
    now: Annotated[
        bool,
        typer.Option("--now", help="End the machine at once; what is not in the bucket is lost."),
    ] = False,
    patience: Annotated[
        int,
        typer.Option("--wait", metavar="SECONDS", min=10, help="How long the stop may take."),
    ] = 600,
    region: Region = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Stop the training of a stack, check that the model is in the bucket, and remove the stack.

    Nothing is deleted until the model has been checked; what the bucket holds of it stays.

    Example: dr-spot stop my-run
    """
    from drcli.spot import stack_end
    from drcli.spot.stacks import need_stack

    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    checkpoint = ""
    if not now:
        with console.waiting(f"Stopping the training of {stack}; waiting until it is saved ..."):
            stack_end.stop_training_there(ours, found, patience_s=patience)
        checkpoint = stack_end.verified_checkpoint(ours, found)
    with console.waiting(f"Removing the stack {stack} ..."):
        report = stack_end.remove_training(ours, found, checkpoint)
    console.emit(report, spot_view.stopped(report), as_json=as_json)


def delete(
    stack: StackName,
    keep_bucket: Annotated[
        bool, typer.Option("--keep-bucket", help="Of a base stack: keep the bucket.")
    ] = False,
    yes: Yes = False,
    region: Region = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Delete a stack and everything that it has made.

    Models stay in the bucket; only a base stack is deleted with its bucket, and with the models in
    it. Asks before.

    Example: dr-spot delete my-run
    """
    from drcli.spot import stack_end
    from drcli.spot.stacks import need_stack

    ours = account(region, profile)
    found = need_stack(ours, stack)
    if found.kind == "base":
        content = stack_end.content_of_bucket(ours, found)
        keep = keep_bucket or content is None
        if keep:
            prompts.agree(f"Delete the stack {stack}? Its bucket stays.", yes=yes, words=[stack])
        elif content is not None:
            console.say(spot_view.content(content))
            prompts.agree(
                f"Delete the stack {stack}, and its bucket {content.bucket} with everything in it? "
                "It cannot be restored.",
                yes=yes,
                words=[stack],
            )
        with console.waiting(f"Deleting the stack {stack} ..."):
            stack_end.remove_base(ours, found, keep_bucket=keep)
        gone = 0 if keep or content is None else content.objects
        report = DeletedBase(stack, found.bucket, gone, keep)
        console.emit(report, spot_view.base_deleted(stack, gone, kept=keep), as_json=as_json)
        return
    if keep_bucket:
        raise SettingsError(
            f"{stack} is a training; its bucket is never deleted with it.",
            remedy="Leave --keep-bucket out.",
        )
    prompts.agree(
        f"Delete the stack {stack} and its machines? A running training loses what it has done "
        f"since its last checkpoint; `dr-spot stop {stack}` saves it first. What the "
        f"bucket holds of the model {found.model} stays.",
        yes=yes,
        words=[stack],
    )
    with console.waiting(f"Deleting the stack {stack} ..."):
        done = stack_end.remove_training(ours, found, "")
    console.emit(done, spot_view.stopped(done), as_json=as_json)
