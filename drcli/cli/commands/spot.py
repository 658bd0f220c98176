"""`dr-spot`: trainings on machines of Amazon."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from drcli.base.errors import Absent, NotAvailable, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.report import counted
from drcli.cli import prompts, terminal
from drcli.cli.commands import viewer
from drcli.cli.commands.spot_watch import watch
from drcli.cli.commands.status import show_status
from drcli.cli.options import DryRun, text_only
from drcli.cli.show import show
from drcli.cli.spot_options import Profile, Region, StackName, Yes, account
from drcli.cli.working_folder import working_folder
from drcli.outside.aws import stacks
from drcli.outside.aws.instance_types import default_types, find_types
from drcli.outside.aws.machine_marks import read_marks
from drcli.outside.aws.racer_files import lay_out
from drcli.outside.aws.stacks import (
    check_name,
    create_stack,
    need_stack,
    our_stacks,
    refuse_existing,
)
from drcli.outside.aws.training_template import KIND_TAG, STACK_TAG, base_template
from drcli.run import stack_plan

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.outside.aws.aws_account import Account
    from drcli.outside.aws.creation import Market

with lazy_imports():
    from drcli.config import loading
    from drcli.outside.aws import creation, machines, stack_end, stack_logs, stack_report
    from drcli.outside.aws import prices as aws_prices
    from drcli.transfer import copy_custom_files


app = typer.Typer(
    no_args_is_help=True,
    help="Train on spot machines of Amazon.\n\nExample: dr-spot prices",
)


# `dr-spot create` and base stacks.


_Processor = Literal["x86", "arm", "any"]
_TYPE_VARIABLE = "DEEPRACER_INSTANCE_TYPE"


@dataclass(frozen=True)
class BaseReport:
    """A bucket and a topic for trainings."""

    stack: Annotated[str, "Name of the stack."]
    region: Annotated[str, "AWS region."]
    bucket: Annotated[str, "Name of the bucket."]
    topic: Annotated[str, "ARN of the topic for messages."]

    def __str__(self) -> str:
        return f"Made {self.stack} in {self.region}: bucket {self.bucket}."


@dataclass(frozen=True)
class AccessReport:
    """Who may reach a stack now, or gets its messages."""

    stack: Annotated[str, "Name of the stack."]
    added: Annotated[str, "The address that may reach the machines, or that gets the messages."]


@app.command("create-base")
def create_base(
    stack: StackName,
    yes: Yes = False,
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Make a bucket and a topic that several trainings share.

    Only the stored objects cost money. The bucket is encrypted, not public, and stays until
    `dr-spot delete` removes it.

    Example: dr-spot create-base racing
    """
    check_name(stack)
    ours = account(region, profile)
    refuse_existing(ours, stack)
    prompts.agree(
        f"Make a bucket and a topic in {ours.region}? Only stored objects cost money.", yes=yes
    )
    tags = {STACK_TAG: stack, KIND_TAG: "base"}
    with terminal.waiting(f"Making the stack {stack} ..."):
        made = create_stack(ours, stack, base_template(stack), tags, roles=False)
    show(BaseReport(stack, ours.region, made.bucket, made.outputs["Topic"]))
    where = {"--region": region, "--profile": profile}
    terminal.suggest([(f"dr-spot create NAME --base {stack}", "start a training")], options=where)


@app.command()
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
) -> None:
    """Train the model that run.env describes on a spot machine.

    Checks settings, files, bucket, quotas and prices, shows what it will cost, and asks. When the
    machine is taken away, the next one continues; when the training ends, so does the machine.

    Example: dr-spot create my-run --base racing --ttl 480
    """
    check_name(stack)
    if on_demand and fallback:
        raise typer.BadParameter("--on-demand uses no spot machine, so there is no --fallback.")
    market: Market = "spot-or-on-demand" if fallback else "on-demand" if on_demand else "spot"
    named = types or os.environ.get(_TYPE_VARIABLE, "").replace(",", " ").split()
    with _folder(files) as folder:
        before = stack_plan.read_settings(folder, region, profile)
        ours = account(region, profile, before)
        topic = ""
        if base:
            shared = need_stack(ours, base, "base")
            bucket = bucket or os.environ.get(stack_plan.BUCKET_VARIABLE) or shared.bucket
            topic = shared.outputs.get("Topic", "")
        stack_options = creation.StackOptions(
            stack,
            bucket or stack_plan.usual_bucket(before),
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
        plan = stack_plan.prepare(
            folder, ours, stack_options, before, install, files or folder, terminal.waiting
        )
        terminal.warn(*plan.notes)
        if show_template:
            terminal.write(json.dumps(plan.template, indent=2) + "\n")
            return
        planned = creation.Planned.of(plan, ours.region)
        if dry_run:
            show(planned)
            return
        terminal.say("\n".join(str(line) for line in planned.view() if line))
        prompts.agree("Start it?", yes=yes, remedy="Add --yes to start it without a question.")
        own = plan.settings
        if own.custom_files.folder.is_dir():
            copy_custom_files.upload_custom_files(own.custom_files, own.storage, terminal.say)
        with terminal.waiting(f"Making the stack {stack} ..."):
            report = creation.carry_out(ours, plan)
    show(report)
    terminal.suggest(_next(stack), options={"--region": region, "--profile": profile})


def _next(stack: str) -> list[tuple[str, str]]:
    return [
        (f"dr-spot status {stack} -f", "watch the training"),
        (f"dr-spot console {stack}", "watch it on a page"),
        ("dr-spot list", "see the machine and what it costs"),
        (f"dr-spot logs {stack}", "read its log"),
        (f"dr-spot stop {stack}", "stop it, and remove the machine"),
    ]


@contextmanager
def _folder(files: Path | None) -> Iterator[Path]:
    if files is None:
        yield working_folder()
        return

    with tempfile.TemporaryDirectory() as name:
        lay_out(files, Path(name))
        yield Path(name)


# `dr-spot list`, `prices`, `cost`, `logs`, `ssh`, access and subscriptions.


_EVERY, _CONSOLE = "all", "console"


@app.command("list")
def list_all(region: Region = None, profile: Profile = None) -> None:
    """List the stacks, their machines and trainings, and what they have cost.

    A machine that could not be set up says so here.

    Example: dr-spot list
    """
    ours = account(region, profile)
    with terminal.waiting(f"Looking for stacks in {ours.region} ...", only_live=True):
        found = stack_report.StackReports(
            ours.region, [stack_report.report_on(ours, each) for each in our_stacks(ours)]
        )
    show(found)


@app.command()
def prices(
    types: Annotated[
        list[str] | None,
        typer.Option("--type", metavar="TYPE", help="Type of machine; may be repeated."),
    ] = None,
    regions: Annotated[
        list[str] | None,
        typer.Option("--region", metavar="TEXT", help="Region, or all; may be repeated."),
    ] = None,
    order: Annotated[
        str,
        typer.Option("--sort-order", "--sort_order", metavar="KEY", help="What to sort by."),
    ] = "PricePerWorkerHour",
    allowed: Annotated[
        list[str] | None,
        typer.Option(
            "--interruption-filter",
            "--interruption_filter",
            metavar="CLASS",
            help="Only types that were interrupted this often, such as '<5%'; may be repeated.",
        ),
    ] = None,
    limit: Annotated[
        int, typer.Option("--limit", metavar="N", min=1, help="Show only the first N.")
    ] = 40,
    profile: Profile = None,
) -> None:
    """Compare spot prices by type and zone, per hour and per simulation worker.

    Keys to sort by: SpotPrice, PricePerWorkerHour, NumberOfWorkers, InterruptionFrequency, Region,
    InstanceType. Interruptions come from Amazon's public Spot Advisor, if it can be reached.

    Example: dr-spot prices --region all --interruption-filter "<5%"
    """
    keys = {each.casefold(): each for each in get_args(aws_prices.SortKey)}
    if order.casefold() not in keys:
        raise typer.BadParameter(
            f"'{order}' is not one of {', '.join(get_args(aws_prices.SortKey))}."
        )
    classes = _classes(allowed or [])
    missing: list[str] = []
    advisor: aws_prices.Advisor = {}
    try:
        advisor = aws_prices.read_advisor()
    except StorageError as error:
        if classes is not None:
            raise
        missing.append(str(error))
    offers: list[aws_prices.Offer] = []
    failed: SettingsError | StorageError | None = None
    named = types or []
    for each in _regions(regions or [], profile):
        with terminal.waiting(f"Asking for prices in {each.region} ...", only_live=True):
            try:
                known = find_types(each, named or default_types("any"), named=False)
                offers += aws_prices.offers_of(each, known, advisor)
            except (SettingsError, StorageError) as error:
                if len(regions or []) == 1 and _EVERY not in (regions or []):
                    raise
                failed = error
                missing.append(str(error))
    if not offers and failed is not None:
        raise failed
    found = aws_prices.Offers(
        aws_prices.arranged(offers, keys[order.casefold()], classes)[:limit], missing
    )
    terminal.warn(*missing)
    show(found)


@app.command()
def cost(
    stack: StackName,
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Show what the machines of a stack have cost: their hours, at the prices of these hours.

    Example: dr-spot cost my-run
    """
    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    marks = read_marks(ours.bucket(found.bucket), stack)
    report = machines.cost_of(ours, stack, machines.machines_of(ours, found, marks))
    terminal.warn(*report.notes)
    show(report)


@app.command()
@text_only
def logs(
    stack: StackName,
    name: Annotated[
        str,
        typer.Argument(
            metavar="[LOG]",
            help="Part of a log's name; without it all are listed. console: what the machine has "
            "printed.",
        ),
    ] = "",
    lines: Annotated[
        int, typer.Option("-n", "--lines", metavar="N", min=1, help="Show the last N lines.")
    ] = 50,
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Show logs of a stack's machines from the bucket: of the training, and of the boot.

    Without a name it lists them, and shows the end of the newest one. `console` asks Amazon what
    the newest machine has printed, where it could not reach the bucket.

    Example: dr-spot logs my-run trainer -n 100
    """
    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    if name == _CONSOLE:
        there = _machines(ours, found)
        if not there:
            raise Absent(
                f"{stack} has had no machine.",
                remedy="`dr-spot list` shows what the stack waits for.",
            )
        terminal.say(f"== {there[-1]}")
        last = stack_logs.read_console(ours, there[-1], lines)
    else:
        chosen = stack_logs.list_logs(ours, found, name)
        newest = max(chosen, key=lambda info: info.modified)
        if not name:
            for info in chosen:
                terminal.say(f"{info.modified:%Y-%m-%d %H:%M} {info.size_bytes:>12,} {info.key}")
        terminal.say(f"== {newest.key}")
        last = stack_logs.read_log(ours, found, newest.key, lines)
    terminal.write("".join(f"{line}\n" for line in last))


@app.command()
def status(
    stack: StackName,
    follow: Annotated[
        bool, typer.Option("-f", "--follow", help="Show the live display until it ends.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="With -f: more numbers.")
    ] = False,
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Show the training of a stack as `dr-status` does, from any folder.

    Exits 5 when a worker has died.

    Example: dr-spot status my-run -f
    """
    ours = account(region, profile)
    report = stack_report.report_on(ours, need_stack(ours, stack), with_cost=False)
    terminal.say(str(report))
    loaded, _ = _seen_from_here(region, profile, stack)
    options = {"--region": region, "--profile": profile}
    commands = _next(stack)[1:]
    reason = report.reason or "It does so a few minutes after its start."
    show_status(
        loaded,
        follow=follow,
        verbose=verbose,
        commands=commands,
        options=options,
        before_any=f"No machine of {stack} has begun to train yet. {reason}",
    )


@app.command()
def console(
    stack: StackName,
    port: viewer.Port = None,
    program: viewer.Program = "",
    browser: viewer.Browser = True,
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Open the console, a web page on this machine, with the training of a stack.

    Works from any folder, and shows the bucket of the stack. It runs in the background; `dr-console
    stop` in the folder data/spot/STACK ends it.

    Example: dr-spot console my-run
    """
    more = {} if port is None else {"DR_WEBVIEWER_PORT": str(port)}
    loaded, environ = _seen_from_here(region, profile, stack, more)
    report = viewer.started_console(loaded, environ=environ)
    viewer.show_console(report, browser, program)


def _seen_from_here(
    region: str | None, profile: str | None, stack: str, more: dict[str, str] | None = None
) -> "tuple[Settings, dict[str, str]]":
    """The settings of a stack's machine, and the environment to read them with."""
    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    folder = working_folder() / "data" / "spot" / stack
    environ = stack_logs.fetch_folder(ours, found, folder, os.environ) | (more or {})
    return loading.load_settings(folder, environ=environ), environ


def _machines(ours: "Account", found: stacks.Stack) -> "list[machines.Machine]":
    """Also where the bucket, which knows more about them, cannot be read."""
    marks = []
    with suppress(StorageError):
        marks = read_marks(ours.bucket(found.bucket), found.name)
    return machines.machines_of(ours, found, marks)


@app.command()
@text_only
def ssh(stack: StackName, region: Region = None, profile: Profile = None) -> None:
    """Open a shell on the machine of a stack, without an open port.

    Needs the AWS command and its Session Manager plugin.

    Example: dr-spot ssh my-run
    """
    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    there = [each for each in _machines(ours, found) if each.state == "running"]
    if not there:
        raise Absent(
            f"No machine of {stack} is running.",
            remedy="`dr-spot list` shows what the stack waits for.",
        )
    command = ["aws", "ssm", "start-session", "--target", there[-1].instance]
    command += ["--region", ours.region]
    command += ["--profile", ours.profile] if ours.profile else []
    missing = [each for each in ("aws", "session-manager-plugin") if shutil.which(each) is None]
    if missing:
        raise NotAvailable(
            f"A shell on {there[-1].instance} needs {' and '.join(missing)}, which "
            f"{'is' if len(missing) == 1 else 'are'} not installed.",
            remedy="Install the AWS command line and its Session Manager plugin "
            "(https://docs.aws.amazon.com/systems-manager/latest/userguide/"
            f"session-manager-working-with-install-plugin.html), then run `{' '.join(command)}`.",
        )
    os.execvp(command[0], command)


@app.command("add-access")
def add_access(
    stack: StackName,
    address: Annotated[str, typer.Argument(metavar="ADDRESS", help="Your public IP address.")],
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Open port 22 of a stack's machines for one address.

    SSH also needs a key pair (`dr-spot create --key-name`). `dr-spot ssh` needs neither.

    Example: dr-spot add-access my-run 203.0.113.7
    """
    ours = account(region, profile)
    added = stacks.add_access(ours, need_stack(ours, stack, "training"), address)
    report = AccessReport(stack, added)
    terminal.emit(report, f"{added} may reach port 22 of the machines of {stack}.")


@app.command()
def subscribe(
    stack: StackName,
    email: Annotated[str, typer.Argument(metavar="MAIL", help="Your mail address.")],
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Send the messages of a stack to a mail address, which must agree first.

    Example: dr-spot subscribe my-run me@example.com
    """
    ours = account(region, profile)
    found = need_stack(ours, stack)
    stacks.subscribe(ours, found.outputs["Topic"], email)
    report = AccessReport(stack, email)
    said = f"Amazon has sent a mail to {email}; messages come after a click on its link."
    terminal.emit(report, said)


def _classes(given: list[str]) -> set[str] | None:
    words = [word for text in given for word in text.replace(",", " ").split()]
    if wrong := [word for word in words if word not in aws_prices.CLASSES]:
        raise typer.BadParameter(f"'{wrong[0]}' is not one of {', '.join(aws_prices.CLASSES)}.")
    return set(words) or None


def _regions(names: list[str], profile: str | None) -> "list[Account]":
    words = [word for text in names for word in text.replace(",", " ").split()]
    if not words:
        return [account(None, profile)]
    if _EVERY not in words:
        return [account(word, profile) for word in words]
    ours = account(None, profile)
    with ours.trying("list the regions"):
        found = ours.client("ec2").describe_regions()["Regions"]
    return [account(entry["RegionName"], profile) for entry in found]


# `dr-spot stop` and `dr-spot delete`.


@dataclass(frozen=True)
class DeletedBase:
    """A base stack that was deleted."""

    stack: Annotated[str, "Name of the stack."]
    bucket: Annotated[str, "Name of the bucket."]
    objects: Annotated[int, "Number of objects that were deleted with the bucket."]
    bucket_kept: Annotated[bool, "Whether the bucket stays."]

    def __str__(self) -> str:
        objects = counted(self.objects, "object")
        rest = "; its bucket stays" if self.bucket_kept else f" with {objects} in its bucket"
        return f"Removed {self.stack}{rest}."


@app.command()
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
) -> None:
    """Stop the training of a stack, check that the model is in the bucket, and remove the stack.

    Nothing is deleted until the model has been checked; what the bucket holds of it stays.

    Example: dr-spot stop my-run
    """
    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    checkpoint = ""
    if not now:
        with terminal.waiting(f"Stopping the training of {stack}; waiting until it is saved ..."):
            stack_end.stop_training_there(ours, found, patience_s=patience)
        checkpoint = stack_end.verified_checkpoint(ours, found)
    with terminal.waiting(f"Removing the stack {stack} ..."):
        report = stack_end.remove_training(ours, found, checkpoint)
    show(report)


@app.command()
def delete(
    stack: StackName,
    keep_bucket: Annotated[
        bool, typer.Option("--keep-bucket", help="Of a base stack: keep the bucket.")
    ] = False,
    yes: Yes = False,
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Delete a stack and everything that it has made.

    Models stay in the bucket; only a base stack is deleted with its bucket, and with the models in
    it. Asks before.

    Example: dr-spot delete my-run
    """
    ours = account(region, profile)
    found = need_stack(ours, stack)
    if found.kind == "base":
        content = stack_end.content_of_bucket(ours, found)
        keep = keep_bucket or content is None
        if keep:
            prompts.agree(f"Delete the stack {stack}? Its bucket stays.", yes=yes, words=[stack])
        elif content is not None:
            terminal.say(str(content))
            prompts.agree(
                f"Delete the stack {stack}, and its bucket {content.bucket} with everything in it? "
                "It cannot be restored.",
                yes=yes,
                words=[stack],
            )
        with terminal.waiting(f"Deleting the stack {stack} ..."):
            stack_end.remove_base(ours, found, keep_bucket=keep)
        gone = 0 if keep or content is None else content.objects
        show(DeletedBase(stack, found.bucket, gone, keep))
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
    with terminal.waiting(f"Deleting the stack {stack} ..."):
        done = stack_end.remove_training(ours, found, "")
    show(done)


app.command()(watch)
