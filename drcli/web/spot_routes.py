"""Trainings on spot machines of Amazon, as `dr-spot` makes, shows and ends them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator
from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.base.json_record import plain
from drcli.config.loading import load_settings
from drcli.outside.aws import stacks
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.creation import Market, StackPlan
from drcli.outside.aws.training_template import KIND_TAG, STACK_TAG, base_template
from drcli.run import stack_plan
from drcli.web.answers import BadRequest, Body, Text, accepts, answers
from drcli.web.model_questions import REQUIRED, dialog, field
from drcli.web.served_folder import ServedFolder
from drcli.web.subprocess_work import in_subprocess
from drcli.web.tasks import Progress

with lazy_imports():
    from drcli.outside.aws import creation, stack_end, stack_logs, stack_report
    from drcli.transfer import copy_custom_files

LOG_LINES = 200
STOP_PATIENCE_S = 600.0
_SAME_USD = 0.0005


class OfStack(Body):
    stack: Text


class PlanStack(OfStack):
    """`base` is a stack with the bucket; without both, the bucket of the settings is used."""

    base: Text = ""
    bucket: Text = ""
    market: Market = "spot"
    ttl_minutes: Annotated[int, Field(ge=0, strict=False)] = 720


class CreateStack(PlanStack):
    agreed_usd_per_hour: float | None
    """Of the dearest machine, which the racer has seen; null if it was not known."""


class StopStack(OfStack):
    now: bool = False


class DeleteStack(OfStack):
    confirm: Any = None
    keep_bucket: bool = False

    @model_validator(mode="after")
    def _confirmed(self) -> Self:
        if self.confirm != self.stack:
            raise BadRequest(f"Type {self.stack} to confirm that it is to be deleted.")
        return self


def _account(directory: Path) -> Account:
    """Wrong settings must not keep anybody from seeing and ending what costs money."""
    settings = None
    with suppress(SettingsError):
        settings = load_settings(directory)
    return stack_plan.account_of(settings)


def _prepared(progress: Progress, directory: Path, body: PlanStack) -> tuple[Account, StackPlan]:
    """Nothing is changed."""

    @contextmanager
    def waiting(what: str) -> Iterator[None]:
        progress(what)
        yield

    before = stack_plan.read_settings(directory)
    ours = stack_plan.account_of(before)
    bucket, topic = body.bucket, ""
    if body.base:
        shared = stacks.need_stack(ours, body.base, "base")
        bucket, topic = bucket or shared.bucket, shared.outputs.get("Topic", "")
    options = creation.StackOptions(
        body.stack,
        bucket or stack_plan.usual_bucket(before),
        market=body.market,
        ttl_minutes=body.ttl_minutes,
        topic=topic,
    )
    stacks.check_name(body.stack)
    return ours, stack_plan.prepare(directory, ours, options, before, "", directory, waiting)


def _plan(progress: Progress, directory: Path, body: PlanStack) -> Any:
    ours, plan = _prepared(progress, directory, body)
    planned = creation.Planned.of(plan, ours.region)
    said = [str(line) for line in planned.view() if line]
    return {**plain(planned), "said": said, "notes": plan.notes}


def _create(progress: Progress, directory: Path, body: CreateStack) -> Any:
    ours, plan = _prepared(progress, directory, body)
    agreed, now = body.agreed_usd_per_hour, plan.estimate.most
    if now is not None and (agreed is None or now > agreed + _SAME_USD):
        was = "not known" if agreed is None else f"{agreed:.3f} USD per hour"
        raise SettingsError(
            f"The price of {body.stack} was {was}, and is up to {now:.3f} USD per hour now; "
            "nothing was started.",
            remedy="Ask for the price again.",
        )
    files = plan.settings.custom_files
    if files.folder.is_dir():
        copy_custom_files.upload_custom_files(files, plan.settings.storage, progress)
    progress("Makes the stack.")
    return creation.carry_out(ours, plan)


def _base(progress: Progress, directory: Path, body: OfStack) -> Any:
    stacks.check_name(body.stack)
    ours = _account(directory)
    stacks.refuse_existing(ours, body.stack)
    tags = {STACK_TAG: body.stack, KIND_TAG: "base"}
    made = stacks.create_stack(ours, body.stack, base_template(body.stack), tags, roles=False)
    return {"stack": body.stack, "bucket": made.bucket}


def _stop(progress: Progress, directory: Path, body: StopStack) -> Any:
    ours = _account(directory)
    found = stacks.need_stack(ours, body.stack, "training")
    checkpoint = ""
    if not body.now:
        progress("Waits until the training has saved its model.")
        stack_end.stop_training_there(ours, found, patience_s=STOP_PATIENCE_S)
        checkpoint = stack_end.verified_checkpoint(ours, found)
    progress("Removes the stack.")
    return str(stack_end.remove_training(ours, found, checkpoint))


def _delete(progress: Progress, directory: Path, body: DeleteStack) -> Any:
    ours = _account(directory)
    found = stacks.need_stack(ours, body.stack)
    if found.kind != "base":
        return str(stack_end.remove_training(ours, found, ""))
    content = stack_end.content_of_bucket(ours, found)
    keep = body.keep_bucket or content is None
    stack_end.remove_base(ours, found, keep_bucket=keep)
    return f"Removed {body.stack}{'; its bucket stays' if keep else ' and its bucket'}."


TASKS: dict[str, tuple[Callable[[Progress, Path, Any], Any], str]] = {
    "plan": (_plan, "Ask what {body.stack} costs"),
    "create": (_create, "Start {body.stack} at Amazon"),
    "base": (_base, "Make a bucket at Amazon for {body.stack}"),
    "stop": (_stop, "Stop {body.stack} at Amazon"),
    "delete": (_delete, "Delete {body.stack} at Amazon"),
}


MARKETS = {
    "spot": "A spot machine: cheaper, may be taken away",
    "spot-or-on-demand": "A spot machine, or an ordinary one while there is none",
    "on-demand": "An ordinary machine",
}
HOURS = (2, 4, 8, 12, 24, 48)
_NAMED = "Of the training at Amazon: letters, digits and hyphens."


def _start_question(found: Sequence[Any], bucket: str) -> dict[str, Any]:
    bases = [(each.stack, f"{each.stack}: {each.bucket}") for each in found if each.kind == "base"]
    places = bases + [("", f"{bucket}, of the settings")] * bool(bucket)
    ends = [(str(60 * hours), f"{hours} hours") for hours in HOURS]
    return dialog(
        "Start a spot training",
        "Ask for the price",
        field("stack", "Name", "", help=_NAMED, more=REQUIRED),
        field("base", "Bucket of the model", places[0][0] if places else "", options=places),
        field("market", "Machine", "spot", options=list(MARKETS.items())),
        field(
            *("ttl_minutes", "Ends at the latest after", "720"),
            options=[*ends, ("0", "No limit: until the training ends")],
        ),
        intro="Nothing is started yet: everything is checked, and the price is shown first.",
    )


def _base_question(region: str) -> dict[str, Any]:
    intro = (
        f"Models of spot machines need a bucket in {region}. Only what is stored in it costs "
        "money, about 0.023 USD for a GB a month."
    )
    name = field("stack", "Name", "", more=REQUIRED)
    return dialog("Make a bucket at Amazon", "Make it", name, intro=intro)


def _end_question(ours: Account, name: str, about: str) -> dict[str, Any]:
    if about == "stop":
        intro = "It saves its model first, which stays in the bucket. This may take some minutes."
        title = f"Stop the training {name}, and remove its machine?"
        return dialog(title, "Stop it", intro=intro, danger=True)
    found = stacks.need_stack(ours, name)
    if found.kind != "base":
        lost = (
            "A training that runs loses what it has done since its last checkpoint; its model "
            "stays in the bucket."
        )
    elif (content := stack_end.content_of_bucket(ours, found)) is None:
        lost = "Its bucket does not exist any more."
    else:
        lost = f"{content} All of it is deleted with the bucket, and cannot be restored."
    typed = field("confirm", f"Type {name} to confirm", "")
    return dialog(f"Delete {name}", "Delete it", typed, intro=lost, danger=True, confirm=name)


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def listed(_: Request) -> Any:
        ours = _account(folder.directory)
        bucket = ""
        with suppress(SettingsError):
            bucket = stack_plan.usual_bucket(folder.settings())
        found = [stack_report.report_on(ours, each) for each in stacks.our_stacks(ours)]
        questions = {"start": _start_question(found, bucket), "base": _base_question(ours.region)}
        return {"region": ours.region, "bucket": bucket, "stacks": found, **questions}

    def logs(request: Request) -> Any:
        ours, asked = _account(folder.directory), request.query_params
        found = stacks.need_stack(ours, asked.get("stack", ""), "training")
        known = stack_logs.list_logs(ours, found)
        newest = max(known, key=lambda info: info.modified).key
        key = next((info.key for info in known if info.key == asked.get("log")), newest)
        lines = stack_logs.read_log(ours, found, key, LOG_LINES)
        return {"logs": [info.key for info in known], "log": key, "lines": lines}

    def question(request: Request) -> Any:
        asked = request.query_params
        ours = _account(folder.directory)
        return _end_question(ours, asked.get("stack", ""), asked.get("about", ""))

    def route(name: str) -> Route:
        work, title = TASKS[name]

        def start(_: Request, body: OfStack) -> Any:
            said = title.format(body=body)

            def run(progress: Progress) -> Any:
                return in_subprocess(progress, work, folder.directory, body, heavy=False)

            goes_on = name != "plan"
            task = folder.tasks.start(f"spot-{name}", body.stack, said, run, goes_on=goes_on)
            return {"task": task.id}

        declared = work.__annotations__["body"]
        return Route(f"/api/spot/{name}", accepts(start, declared), methods=["POST"])

    return [
        Route("/api/spot", answers(listed)),
        Route("/api/spot/logs", answers(logs)),
        Route("/api/spot/question", answers(question)),
        *map(route, TASKS),
    ]
