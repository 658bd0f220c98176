"""`dr-spot create`, base stacks, access and subscriptions."""

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drcli.base.errors import SettingsError
from drcli.base.problems import ProblemsError
from drcli.cli import console, prompts
from drcli.cli.options import AsJson, DryRun
from drcli.cli.spot_options import Profile, Region, StackName, Yes, account, usual_region
from drcli.cli.views import spot_view
from drcli.cli.working_folder import working_folder

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.spot.aws_account import Account
    from drcli.spot.before_spending import Market

_Processor = Literal["x86", "arm", "any"]
_BUCKET_VARIABLE, _TYPE_VARIABLE = "BUCKET", "DEEPRACER_INSTANCE_TYPE"


@dataclass(frozen=True)
class BaseReport:
    """A bucket and a topic for trainings.

    Attributes:
        stack: Name of the stack.
        region: AWS region.
        bucket: Name of the bucket.
        topic: ARN of the topic for messages.
    """

    stack: str
    region: str
    bucket: str
    topic: str


@dataclass(frozen=True)
class AccessReport:
    """Who may reach a stack now, or gets its messages.

    Attributes:
        stack: Name of the stack.
        added: The address that may reach the machines, or that gets the messages.
    """

    stack: str
    added: str


def create_base(
    stack: StackName,
    yes: Yes = False,
    region: Region = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Make a bucket and a topic that several trainings share.

    Only the stored objects cost money. The bucket is encrypted, not public, and stays until
    `dr-spot delete` removes it.

    Example: dr-spot create-base racing
    """
    from drcli.spot.base_template import base_template
    from drcli.spot.stacks import check_name, create_stack, refuse_existing
    from drcli.spot.training_template import KIND_TAG, STACK_TAG

    check_name(stack)
    ours = account(region, profile)
    refuse_existing(ours, stack)
    prompts.agree(
        f"Make a bucket and a topic in {ours.region}? Only stored objects cost money.", yes=yes
    )
    tags = {STACK_TAG: stack, KIND_TAG: "base"}
    with console.waiting(f"Making the stack {stack} ..."):
        made = create_stack(ours, stack, base_template(stack), tags, roles=False)
    report = BaseReport(stack, ours.region, made.bucket, made.outputs["Topic"])
    console.emit(report, spot_view.base(stack, ours.region, made.bucket), as_json=as_json)
    console.suggest([(f"dr-spot create NAME --base {stack}", "start a training")])


def create(
    stack: StackName,
    base: Annotated[
        str, typer.Option("--base", metavar="STACK", help="Base stack with the bucket.")
    ] = "",
    bucket: Annotated[
        str,
        typer.Option(
            "--bucket", metavar="NAME", help="A bucket that exists, instead of a base stack."
        ),
    ] = "",
    ttl: Annotated[
        int,
        typer.Option(
            "--ttl",
            metavar="MINUTES",
            min=0,
            help="Time after which the machines end; 0 for never.",
        ),
    ] = 720,
    types: Annotated[
        list[str] | None,
        typer.Option(
            "--type", metavar="TYPE", help="Type of machine; may be repeated. Default: several."
        ),
    ] = None,
    processor: Annotated[
        _Processor, typer.Option("--processor", help="x86, arm or any, for the default types.")
    ] = "x86",
    on_demand: Annotated[
        bool, typer.Option("--on-demand", help="Use an ordinary machine, which nobody takes away.")
    ] = False,
    fallback: Annotated[
        bool,
        typer.Option("--fallback", help="Use an ordinary machine while there is no spot machine."),
    ] = False,
    max_price: Annotated[
        float | None,
        typer.Option(
            "--max-price", metavar="USD", help="Highest price per hour of a spot machine."
        ),
    ] = None,
    disk: Annotated[
        int, typer.Option("--disk", metavar="GB", min=10, max=1000, help="Size of the disk.")
    ] = 30,
    files: Annotated[
        Path | None,
        typer.Option(
            "--files",
            metavar="FOLDER",
            help="Folder with run.env and all other files, as custom-files/ of "
            "deepracer-on-the-spot; default: the working folder.",
        ),
    ] = None,
    install: Annotated[
        str,
        typer.Option(
            "--install",
            metavar="SOURCE",
            help="What the machine installs: a wheel, git+https://..., or drcli==VERSION. Default: "
            "the drcli that runs here.",
        ),
    ] = "",
    email: Annotated[
        str, typer.Option("--email", metavar="ADDRESS", help="Send messages there.")
    ] = "",
    key_name: Annotated[
        str, typer.Option("--key-name", metavar="NAME", help="Key pair, for SSH with add-access.")
    ] = "",
    image: Annotated[
        str, typer.Option("--image", metavar="AMI", help="Disk image; default: Ubuntu 24.04.")
    ] = "",
    subnets: Annotated[
        list[str] | None,
        typer.Option("--subnet", metavar="ID", help="Subnet; may be repeated. Default: all."),
    ] = None,
    show_template: Annotated[
        bool, typer.Option("--show-template", help="Print the template instead of using it.")
    ] = False,
    dry_run: DryRun = False,
    yes: Yes = False,
    region: Region = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Train the model that run.env describes on a spot machine.

    Checks settings, files, bucket, quotas and prices, shows what it will cost, and asks. When the
    machine is taken away, the next one continues; when the training ends, so does the machine.

    Example: dr-spot create my-run --base racing --ttl 480
    """
    from drcli.models.copy_custom_files import upload_custom_files
    from drcli.spot import creation
    from drcli.spot.before_spending import Wishes, check_wishes
    from drcli.spot.install_source import find_source
    from drcli.spot.stacks import check_name, need_stack

    check_name(stack)
    if on_demand and fallback:
        raise typer.BadParameter("--on-demand uses no spot machine, so there is no --fallback.")
    market: Market = "spot-or-on-demand" if fallback else "on-demand" if on_demand else "spot"
    named = types or os.environ.get(_TYPE_VARIABLE, "").replace(",", " ").split()
    with _folder(files) as folder:
        before = _loaded(folder, _later(region, profile))
        ours = account(region, profile, before)
        topic = ""
        if base:
            shared = need_stack(ours, base, "base")
            bucket = bucket or os.environ.get(_BUCKET_VARIABLE) or shared.bucket
            topic = shared.outputs.get("Topic", "")
        wishes = Wishes(
            stack,
            bucket or _usual_bucket(before),
            tuple(named),
            processor,
            market,
            ttl,
            max_price,
            disk,
            topic,
            email,
            key_name,
            image,
            tuple(subnets or ()),
        )
        check_wishes(wishes)
        loaded = _checked(folder, ours, wishes.bucket, stack, before)
        with console.waiting("Preparing what the machine installs ..."):
            source = find_source(install)
        with console.waiting(f"Asking Amazon for quotas and prices in {ours.region} ..."):
            plan = creation.prepare(ours, loaded, wishes, source)
        if show_template:
            console.write(json.dumps(plan.template, indent=2) + "\n")
            return
        console.warn(*plan.notes)
        if dry_run:
            planned = spot_view.Planned.of(plan, ours.region)
            console.emit(planned, spot_view.plan(plan, ours.region), as_json=as_json)
            return
        console.say(spot_view.plan_text(plan, ours.region))
        prompts.agree("Start it?", yes=yes, remedy="Add --yes to start it without a question.")
        if loaded.custom_files.folder.is_dir():
            upload_custom_files(loaded.custom_files, loaded.storage, console.say)
        with console.waiting(f"Making the stack {stack} ..."):
            report = creation.carry_out(ours, plan)
    console.emit(report, spot_view.created(report), as_json=as_json)
    console.suggest(
        [
            ("dr-spot list", "see how it is"),
            (f"dr-spot logs {stack}", "read its log"),
            (f"dr-spot stop {stack}", "stop it, and remove the machine"),
        ]
    )


def add_access(
    stack: StackName,
    address: Annotated[str, typer.Argument(metavar="ADDRESS", help="Your public IP address.")],
    region: Region = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Open port 22 of a stack's machines for one address.

    SSH also needs a key pair (`dr-spot create --key-name`). `dr-spot ssh` needs neither.

    Example: dr-spot add-access my-run 203.0.113.7
    """
    from drcli.spot import stack_access
    from drcli.spot.stacks import need_stack

    ours = account(region, profile)
    added = stack_access.add_access(ours, need_stack(ours, stack, "training"), address)
    report = AccessReport(stack, added)
    console.emit(report, f"{added} may reach port 22 of the machines of {stack}.", as_json=as_json)


def subscribe(
    stack: StackName,
    email: Annotated[str, typer.Argument(metavar="MAIL", help="Your mail address.")],
    region: Region = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Send the messages of a stack to a mail address, which must agree first.

    Example: dr-spot subscribe my-run me@example.com
    """
    from drcli.spot import stack_access
    from drcli.spot.stacks import need_stack

    ours = account(region, profile)
    found = need_stack(ours, stack)
    stack_access.subscribe(ours, found.outputs["Topic"], email)
    report = AccessReport(stack, email)
    said = f"Amazon has sent a mail to {email}; messages come after a click on its link."
    console.emit(report, said, as_json=as_json)


@contextmanager
def _folder(files: Path | None) -> Iterator[Path]:
    if files is None:
        yield working_folder()
        return
    from drcli.spot.racer_files import lay_out

    with tempfile.TemporaryDirectory() as name:
        lay_out(files, Path(name))
        yield Path(name)


def _later(region: str | None, profile: str | None) -> dict[str, str]:
    names = ("DEEPRACER_S3_URI", "DR_S3_URI", "MY_BUCKET")
    found = dict.fromkeys(names, os.environ.get(_BUCKET_VARIABLE) or "bucket")
    found["DEEPRACER_REGION"] = region or usual_region(profile)
    return {name: value for name, value in found.items() if name not in os.environ}


def _loaded(folder: Path, variables: dict[str, str]) -> "Settings":
    from drcli.config.loading import load_settings

    return load_settings(folder, environ={**os.environ, **variables})


def _usual_bucket(loaded: "Settings") -> str:
    if named := os.environ.get(_BUCKET_VARIABLE):
        return named
    if loaded.cloud == "aws":
        return loaded.bucket
    raise SettingsError(
        "No bucket at Amazon is named.",
        remedy="Make one with `dr-spot create-base NAME` and add --base NAME, or add --bucket.",
    )


def _checked(
    folder: Path, ours: "Account", bucket: str, stack: str, before: "Settings"
) -> "Settings":
    from drcli.checks import validate
    from drcli.spot.before_spending import check_bucket
    from drcli.spot.racer_files import environment

    check_bucket(ours, bucket)
    variables = environment(bucket, ours.region, stack, before.upload_s3_bucket)
    variables["DR_LOCAL_S3_PROFILE"] = ours.profile or "default"
    loaded = _loaded(folder, variables)
    with console.waiting("Checking settings, files and reward function ..."):
        report = validate.validate(folder, environ={**os.environ, **variables}, here=False)
    console.warn(*(str(each) for each in report.warnings if each.rule != "V-50"))  # of this machine
    if not report.ok:
        raise ProblemsError(list(report.errors))
    return loaded
