"""`dr-spot list`, `prices`, `cost`, `logs` and `ssh`."""

import os
import shutil
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from drcli.base.errors import Absent, NotAvailable, SettingsError, StorageError
from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.spot_options import Profile, Region, StackName, account
from drcli.cli.views import spot_view

if TYPE_CHECKING:
    from drcli.spot.aws_account import Account

_EVERY = "all"


def list_all(region: Region = None, profile: Profile = None, as_json: AsJson = False) -> None:
    """List the stacks, their machines and trainings, and what they have cost.

    A machine that could not be set up says so here.

    Example: dr-spot list
    """
    from drcli.spot.stack_report import StackReports, report_on
    from drcli.spot.stacks import our_stacks

    ours = account(region, profile)
    with console.waiting(f"Looking for stacks in {ours.region} ...", only_live=True):
        found = StackReports(ours.region, [report_on(ours, each) for each in our_stacks(ours)])
    console.emit(found, spot_view.stacks(found), as_json=as_json)


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
    as_json: AsJson = False,
) -> None:
    """Compare spot prices by type and zone, per hour and per simulation worker.

    Keys to sort by: SpotPrice, PricePerWorkerHour, NumberOfWorkers, InterruptionFrequency, Region,
    InstanceType. Interruptions come from Amazon's public Spot Advisor, if it can be reached.

    Example: dr-spot prices --region all --interruption-filter "<5%"
    """
    from drcli.spot.instance_types import default_types, find_types
    from drcli.spot.prices import Offer, Offers, SortKey, arranged, offers_of
    from drcli.spot.spot_advisor import Advisor, read_advisor

    keys = {each.casefold(): each for each in get_args(SortKey)}
    if order.casefold() not in keys:
        raise typer.BadParameter(f"'{order}' is not one of {', '.join(get_args(SortKey))}.")
    classes = _classes(allowed or [])
    missing: list[str] = []
    advisor = Advisor({})
    try:
        advisor = read_advisor()
    except StorageError as error:
        if classes is not None:
            raise
        missing.append(str(error))
    offers: list[Offer] = []
    named = types or []
    for each in _regions(regions or [], profile):
        with console.waiting(f"Asking for prices in {each.region} ...", only_live=True):
            try:
                known = find_types(each, named or default_types("any"), named=False)
                offers += offers_of(each, known, advisor)
            except (SettingsError, StorageError) as error:
                if len(regions or []) == 1 and _EVERY not in (regions or []):
                    raise
                missing.append(str(error))
    if not offers and missing:
        raise StorageError(missing[-1], remedy="Choose other types or regions.")
    found = Offers(arranged(offers, keys[order.casefold()], classes)[:limit], missing)
    console.warn(*missing)
    console.emit(found, spot_view.offers(found), as_json=as_json)


def cost(
    stack: StackName,
    region: Region = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Show what the machines of a stack have cost: their hours, at the prices of these hours.

    Example: dr-spot cost my-run
    """
    from drcli.spot.machine_cost import cost_of
    from drcli.spot.machine_marks import read_marks
    from drcli.spot.machines import machines_of
    from drcli.spot.stacks import need_stack

    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    marks = read_marks(ours.bucket(found.bucket), stack)
    report = cost_of(ours, stack, machines_of(ours, found, marks))
    console.warn(*report.notes)
    console.emit(report, spot_view.cost(report), as_json=as_json)


def logs(
    stack: StackName,
    name: Annotated[
        str,
        typer.Argument(metavar="[LOG]", help="Part of a log's name; without it all are listed."),
    ] = "",
    lines: Annotated[
        int, typer.Option("-n", "--lines", metavar="N", min=1, help="Show the last N lines.")
    ] = 50,
    region: Region = None,
    profile: Profile = None,
) -> None:
    """Show logs of a stack's machines from the bucket: of the training, and of the boot.

    Without a name it lists them, and shows the end of the newest one.

    Example: dr-spot logs my-run trainer -n 100
    """
    from drcli.spot.machine_marks import log_folder
    from drcli.spot.stacks import need_stack
    from drcli.store import keys

    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    bucket = ours.bucket(found.bucket)
    folders = (f"{keys.folder(found.model)}logs/", log_folder(stack))
    every = [info for folder in folders for info in bucket.list(folder)]
    chosen = [info for info in every if name in info.key.rpartition("/")[2]]
    if not chosen:
        raise Absent(
            f"{stack} has no log{f' {name}' if name else ''} in the bucket yet.",
            remedy="A machine writes its first log a few minutes after its start; `dr-spot list` "
            "shows how it is.",
        )
    newest = max(chosen, key=lambda info: info.modified)
    if not name:
        for info in every:
            console.say(f"{info.modified:%Y-%m-%d %H:%M} {info.size_bytes:>12,} {info.key}")
    console.say(f"== {newest.key}")
    text = bucket.get(newest.key).decode(errors="replace").splitlines()
    console.write("".join(f"{line}\n" for line in text[-lines:]))


def ssh(stack: StackName, region: Region = None, profile: Profile = None) -> None:
    """Open a shell on the machine of a stack, without an open port.

    Needs the AWS command and its Session Manager plugin.

    Example: dr-spot ssh my-run
    """
    from drcli.spot.machine_marks import read_marks
    from drcli.spot.machines import machines_of
    from drcli.spot.stacks import need_stack

    ours = account(region, profile)
    found = need_stack(ours, stack, "training")
    marks = []
    with suppress(StorageError):
        marks = read_marks(ours.bucket(found.bucket), stack)
    there = [each for each in machines_of(ours, found, marks) if each.state == "running"]
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


def _classes(given: list[str]) -> set[str] | None:
    from drcli.spot.spot_advisor import CLASSES

    words = [word for text in given for word in text.replace(",", " ").split()]
    if wrong := [word for word in words if word not in CLASSES]:
        raise typer.BadParameter(f"'{wrong[0]}' is not one of {', '.join(CLASSES)}.")
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
