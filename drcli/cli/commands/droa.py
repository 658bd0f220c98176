"""`dr droa`."""

import inspect
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, wraps
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Concatenate, Literal, ParamSpec, get_args

import typer

from drcli.base import errors
from drcli.base.errors import SettingsError, StorageError
from drcli.base.files import refuse_existing
from drcli.base.installation import lazy_imports
from drcli.base.report import View, bold, second, table
from drcli.cli import prompts, terminal
from drcli.cli.options import (
    DryRun,
    ReplaceOrYes,
    best_option,
    checkpoint_choice,
    checkpoint_option,
    prefix_option,
)
from drcli.cli.show import show
from drcli.cli.working_folder import settings
from drcli.config import secret_environment
from drcli.config.settings import Settings
from drcli.config.value_types import CheckpointChoice
from drcli.convert.droa_rules import INDEX, POINTER
from drcli.model import keys
from drcli.model.checkpoint_choice import ModelCheckpoints
from drcli.model.model_store import ModelStore
from drcli.outside.droa.droa_package import Files, read_package
from drcli.outside.droa.droa_session import DroaSession
from drcli.outside.droa.droa_site import (
    PASSWORD_VARIABLE,
    URL_SETTING,
    SiteOptions,
    find_site,
    refuse_no_site,
)
from drcli.outside.web_request import Web
from drcli.records.scores import encode_single

if TYPE_CHECKING:
    from drcli.outside.droa.droa_api import Droa

with lazy_imports():
    from drcli.model import checkpoint_list
    from drcli.model.files import params_yaml
    from drcli.outside.droa import droa_api, droa_download, droa_import, droa_metrics, droa_races
    from drcli.tracks import track_list
    from drcli.transfer import export_droa, export_model, transfer_buckets


@dataclass(frozen=True)
class SignedIn:
    """The result of `droa-login`."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    username: Annotated[str, "Who signed in."]
    expires: Annotated[str, "When the temporary keys end, ISO 8601."]

    def __str__(self) -> str:
        until = second(self.expires)
        return f"Signed in to {self.site} as {self.username}, until {until} UTC."


@dataclass(frozen=True)
class SignedOut:
    """The result of `droa-logout`."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    username: Annotated[str, "Whose keys were meant."]
    deleted: Annotated[bool, "Whether there were any."]

    def __str__(self) -> str:
        keys = f"temporary keys of {self.username} for {self.site}"
        return f"Deleted the {keys}." if self.deleted else f"There were no {keys}."


@dataclass(frozen=True)
class RemoteModels:
    """The models in an account."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    models: Annotated[
        list[dict[str, Any]],
        "The newest first, each with the keys of the interface, such as modelId and status.",
    ]

    def view(self) -> View:
        found = [droa_api.read_model(model, self.site) for model in self.models]
        none = f"There is no model in your account at {self.site}."
        order = ("name", "model_id", "status", "training_status", "created_at")
        return [bold(self.site), table(found, *order)] if found else [none]


# Options and connection of all `droa-*` commands.


P = ParamSpec("P")

pause: Callable[[float], None] = time.sleep
_PANEL: tuple[tuple[str, str], ...] = (
    ("url", "Address of DeepRacer on AWS, instead of DR_DROA_URL."),
    ("username", "User, instead of DR_DROA_USERNAME."),
    ("password", "Password; without it you are asked, which keeps it out of the history."),
    ("region", "AWS region, instead of the one in env.js."),
    ("user_pool_id", "Cognito user pool, instead of the one in env.js."),
    ("user_pool_client_id", "Cognito client, instead of the one in env.js."),
    ("identity_pool_id", "Cognito identity pool, instead of the one in env.js."),
    ("api_endpoint", "Address of the interface, instead of the one in env.js."),
    ("upload_bucket", "Bucket for imports, instead of the one in env.js."),
)


class Connection:
    """Connects only when a command is ready for it."""

    def __init__(self, given: dict[str, str | None]) -> None:
        self._given = given

    def refuse_no_site(self) -> None:
        """Refuse a missing site before anything slow.

        Raises:
            SettingsError: The address is missing or wrong.
        """
        refuse_no_site(self._site_options(), settings().droa.url)

    def session(self) -> "DroaSession":
        """The user, before any request but env.js.

        Raises:
            DrError: A setting is missing or wrong, or env.js cannot be read.
        """
        return self.droa().session

    def droa(self) -> "Droa":
        """The interface, as this user.

        Raises:
            DrError: As for `session`.
        """
        config = settings().droa
        web = Web(
            "--url" if self._given["url"] else URL_SETTING,
            pause=lambda seconds: pause(seconds),
            trace=_trace if config.debug else None,
        )
        site = find_site(self._site_options(), config.url, config.aws_endpoint_url, web)
        username = self._given["username"] or config.username
        return droa_api.Droa(
            DroaSession(site, username, lambda: self._password(username), _code), web
        )

    def _site_options(self) -> "SiteOptions":
        given = {n: v for n, v in self._given.items() if n not in ("username", "password")}
        return SiteOptions(**given)

    def _password(self, username: str) -> str:
        known = self._given["password"] or secret_environment.all_secrets().get(PASSWORD_VARIABLE)
        return known or prompts.secret(
            f"Password for {username}",
            "Run the command on a terminal, or give the password on standard input or in the "
            f"variable {PASSWORD_VARIABLE}.",
        )


def connected(
    command: Callable[Concatenate[Connection, P], None],
) -> Callable[P, None]:
    """Gives a command these options, and the connection as first parameter."""
    signature = inspect.signature(command)

    @wraps(command)
    def run(*args: P.args, **named: P.kwargs) -> None:
        given: dict[str, Any] = {name: named.pop(name, None) for name, _ in _PANEL}
        command(Connection(given), *args, **named)

    kind = inspect.Parameter.KEYWORD_ONLY
    shared = [
        inspect.Parameter(name, kind, default=None, annotation=_option(name, text))
        for name, text in _PANEL
    ]
    own = [each.replace(kind=kind) for each in list(signature.parameters.values())[1:]]
    vars(run)["__signature__"] = signature.replace(parameters=[*own, *shared])
    return run


def _option(name: str, text: str) -> Any:
    flag = f"--{name.replace('_', '-')}"
    return Annotated[str | None, typer.Option(flag, metavar="TEXT", help=text)]


def _code(question: str) -> str:
    return prompts.secret(question, "Run the command on a terminal.")


def _trace(line: str) -> None:
    terminal.err.print(line, markup=False, soft_wrap=True)


# Takes a model of the racer's bucket for DeepRacer on AWS.


def read_bucket_model(settings: Settings, prefix: str, choice: CheckpointChoice) -> Files:
    """A model's files with a TensorFlow checkpoint, its own or as of `dr-export droa`.

    Raises:
        SettingsError: There is none, or it cannot be imported there.
        StorageError: The bucket cannot be read.
    """
    bucket = transfer_buckets.bucket_to_look_at(settings.transfer, upload=False)
    model = ModelStore(bucket, prefix)
    checkpoint_list.refuse_incomplete(settings.model, model)
    checkpoints = ModelCheckpoints.read(ModelStore.of(settings.model, bucket, prefix))
    chosen = checkpoints.choose(choice)
    if not set(keys.TENSORFLOW_PARTS) <= set(chosen.parts):
        exported = export_droa.read_droa_export(
            settings, export_model.Selection(choice, prefix), world=None
        )
        for note in exported.notes:
            errors.show(note)
        return export_droa.package_files(exported)
    errors.show(checkpoints.sentence_about(chosen))
    items = [
        *checkpoint_list.read_checkpoint(model, chosen),
        *checkpoint_list.read_model_files(
            settings.model,
            model,
            chosen.name,
            (bucket.name, prefix),
            params_yaml.training_parameters(settings),
        ),
    ]
    files = {item.name: item.data for item in items if not item.name.endswith(".safetensors")}
    files[POINTER] = chosen.name.encode()
    files[INDEX] = encode_single(chosen.score)
    files[checkpoint_list.PARAMETERS_FILE] = _parameters(
        settings, files[checkpoint_list.PARAMETERS_FILE], prefix
    )
    metrics = files.pop("metrics/TrainingMetrics.json", None)
    if metrics:
        files[f"metrics/training/training-{chosen.number}.json"] = metrics
    return files


def _parameters(settings: Settings, data: bytes, prefix: str) -> bytes:
    try:
        return params_yaml.droa_parameters(data, _route(settings, data))
    except ValueError as e:
        raise SettingsError(
            f"{checkpoint_list.PARAMETERS_FILE} of {prefix} cannot be used: {e}.",
            remedy="Add TRACK_DIRECTION_CLOCKWISE: true or false to it, in a folder that you "
            "import with --from.",
        ) from e


def _route(settings: Settings, data: bytes) -> "params_yaml.Direction | None":
    world = str(params_yaml.read_parameters(data).get("WORLD_NAME", ""))
    track, named = params_yaml.split_world(world)
    if named is not None or len(params_yaml.DROA_TRACKS.get(track, ())) == 1:
        return None  # measuring all tracks takes two seconds
    memory = settings.directory / "data" / "cache" / "tracks.json"
    known = {"clockwise": params_yaml.CLOCKWISE, "counterclockwise": params_yaml.COUNTER_CLOCKWISE}
    for facts in track_list.list_tracks(settings.tracks_folder, memory).tracks:
        if facts.name == world:
            return known.get(facts.direction)
    return None


app = typer.Typer(
    no_args_is_help=True,
    help="Import models into DeepRacer on AWS, manage them there, and submit them to races.\n\n"
    "The names `droa-login`, `droa-list-models` and so on work too.\n\n"
    "Example: dr-droa list",
)

_Model = Annotated[
    str, typer.Argument(metavar="MODEL", help="Id of the model, or its name if only one has it.")
]
_Yes = Annotated[bool, typer.Option("-f", "--force", "-y", "--yes", help="Do not ask; answer yes.")]
_Kind = Literal["TRAINING_LOGS", "EVALUATION_LOGS", "PHYSICAL_CAR_MODEL", "VIRTUAL_MODEL", "VIDEOS"]


@app.command("login")
@connected
def droa_login(connection: Connection) -> None:
    """Sign in to DeepRacer on AWS; other commands then need no password for an hour.

    Keeps temporary keys in ~/.droa-cache, never the password. The other commands sign in
    themselves if they must.

    Example: dr-droa login --username me@example.com
    """
    session = connection.session()
    with terminal.waiting(f"Signing in to {session.site.place} ..."):
        keys = session.renew()
    show(SignedIn(session.site.place, session.username, keys.expires.isoformat()))


@app.command("logout")
@connected
def droa_logout(connection: Connection) -> None:
    """Delete the temporary keys of DeepRacer on AWS from this machine.

    The keys are in ~/.droa-cache; if the site is gone, delete that folder.

    Example: dr-droa logout
    """
    session = connection.session()
    show(SignedOut(session.site.place, session.username, session.forget()))


@app.command("list")
@connected
def droa_list_models(connection: Connection) -> None:
    """List your models at DeepRacer on AWS, the newest first.

    With --json, each model has the keys of its interface.

    Example: dr-droa list
    """
    droa = connection.droa()
    show(RemoteModels(droa.place, [model.values for model in droa.models()]))


@app.command("show")
@connected
def droa_get_model(
    connection: Connection,
    model: _Model,
    verbose: Annotated[
        bool,
        typer.Option("-v", "--verbose", help="Also show actions, reward function and addresses."),
    ] = False,
    summary: Annotated[
        bool, typer.Option("--summary", help="Also show means of its training metrics.")
    ] = False,
) -> None:
    """Show a model at DeepRacer on AWS.

    Example: dr-droa show 2w7R6h2PNexQ9kC --summary
    """
    droa = connection.droa()
    found = droa.find(model)
    means = droa_metrics.metrics_summary(droa, found) if summary else []
    show(droa_metrics.ModelReport(**vars(found), means=means), verbose=verbose)


@app.command("import")
@connected
def droa_import_model(
    connection: Connection,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            "--model-dir",
            metavar="PATH",
            help="Folder or archive of the model, as dr-export droa writes it.",
        ),
    ] = None,
    prefix: Annotated[
        str | None,
        prefix_option("Import this model of the bucket; default: yours.", "--model-prefix"),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option("--model-name", metavar="NAME", help="Its name at DeepRacer on AWS."),
    ] = None,
    description: Annotated[
        str, typer.Option("--model-description", metavar="TEXT", help="Its description.")
    ] = "",
    best: Annotated[bool, best_option("Import")] = False,
    number: Annotated[str | None, checkpoint_option("Import")] = None,
    no_wait: Annotated[
        bool, typer.Option("--no-wait", help="Do not wait until the model is checked there.")
    ] = False,
    unchecked: Annotated[
        bool, typer.Option("--unchecked", help="Import even if the check here finds errors.")
    ] = False,
    once: Annotated[
        bool,
        typer.Option("--once", help="Do nothing if the same weights were imported with --once."),
    ] = False,
    dry_run: DryRun = False,
) -> None:
    """Import a model into DeepRacer on AWS, and wait for its verdict.

    Takes a folder or archive on disk, or a model in your bucket, whose checkpoint is converted if
    it was trained here. All rules that are known of DeepRacer on AWS are checked before anything is
    sent. With --once, the description has a fingerprint of the weights.

    Example: dr-droa import --from my-model.tar.gz --model-name my-model
    """
    if source is not None and (prefix or best or number is not None):
        raise typer.BadParameter(
            "--from takes a folder or archive as it is; --model-prefix, --best and --checkpoint "
            "choose a model in the bucket. Use only one of both."
        )
    choice = checkpoint_choice(best, number)
    connection.refuse_no_site()
    if source is not None:
        files, found_name = read_package(source), _stem(source)
    else:
        loaded = settings()
        chosen = prefix or loaded.model_prefix
        files = read_bucket_model(loaded, chosen, choice)
        found_name = chosen
    if once:
        description = f"{description} {droa_import.fingerprint_of(files)}".strip()
    plan = droa_import.plan_import(
        files, found_name if name is None else name, description, unchecked=unchecked
    )
    droa = connection.droa()
    before = droa_import.find_import(droa, plan) if once else None
    if before is not None:
        report = before
    elif dry_run:
        report = droa_import.planned_report(droa.place, plan)
    else:
        report = droa_import.import_files(
            droa,
            plan,
            progress=partial(terminal.progress, unit="bytes"),
            waiting=None if no_wait else terminal.waiting,
        )
    show(report)
    if not dry_run:
        of_it = (f"dr-droa show {report.model_id}", "show it")
        races = ("dr-droa races", "list the races that it can enter")
        terminal.suggest([of_it, ("dr-droa list", "list your models there"), races])


@app.command("races")
@connected
def droa_races_list(connection: Connection) -> None:
    """List the races at DeepRacer on AWS, those that take submissions first.

    Example: dr-droa races
    """
    show(droa_races.list_races(connection.droa()))


@app.command("submit")
@connected
def droa_submit(
    connection: Connection,
    model: _Model,
    race: Annotated[
        str, typer.Argument(metavar="RACE", help="Id of the race, or its name if only one has it.")
    ],
    every: Annotated[
        float | None,
        typer.Option(
            "--every", metavar="MINUTES", min=1.0, help="Submit it again after so many minutes."
        ),
    ] = None,
    times: Annotated[
        int | None,
        typer.Option(
            "--times", metavar="N", min=1, help="At most so often; with --every, else once."
        ),
    ] = None,
    no_wait: Annotated[
        bool, typer.Option("--no-wait", help="Do not wait until it was driven there.")
    ] = False,
) -> None:
    """Submit a model to a race of DeepRacer on AWS, once or again and again, and show its time.

    Each submission drives anew, so a model may do better the next time. With --every it goes on
    until the race closes, or allows no more submissions; a failed call is tried again then. Imports
    of models: dr-droa import.

    Example: dr-droa submit my-model "Summer race" --every 30 --times 5
    """
    if times is not None and every is None:
        raise typer.BadParameter("--times needs --every.")
    droa = connection.droa()
    chosen = droa.find(model)
    entered = droa_races.find_race(droa, race)
    droa_races.refuse_closed(droa, entered)
    if every is not None and (no_wait or entered.is_live):
        raise typer.BadParameter(
            "--every waits for each submission, which neither --no-wait nor a live race allows."
        )
    for turn in count(1):
        began_s = time.monotonic()
        try:
            if turn > 1:
                chosen = droa.model(chosen.model_id)
                entered = droa_races.find_race(droa, entered.race_id)
            if not entered.is_open:
                terminal.say(f"The race {entered.name} takes no more submissions.")
                return
            waiting = None if no_wait else terminal.waiting
            if turn > 1 and chosen.status != "READY":
                raise StorageError(
                    f"The model {chosen.name} has the status {chosen.status}.",
                    remedy="It is submitted in the next turn.",
                )
            report = droa_races.submit(droa, entered, chosen, waiting)
        except StorageError as error:
            if turn == 1 or turn == times:
                raise
            terminal.warn(f"{error} {error.remedy}")
        else:
            show(report)
            if every is not None and report.number >= entered.most_submissions:
                terminal.say(f"That was the last submission that {entered.name} allows you.")
                return
        if every is None or turn == times:
            return
        droa.pause(max(0.0, every * 60.0 - (time.monotonic() - began_s)))


@app.command("download")
@connected
def droa_download_logs(
    connection: Connection,
    model: _Model,
    kind: Annotated[
        _Kind,
        typer.Option(
            "--asset-type",
            metavar="TYPE",
            show_default=False,
            help=f"One of {', '.join(get_args(_Kind))}; the first one if not given.",
        ),
    ] = "TRAINING_LOGS",
    evaluation: Annotated[
        str, typer.Option("--evaluation-id", metavar="ID", help="For EVALUATION_LOGS: which one.")
    ] = "",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="PATH", help="File to write, or folder for it."),
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Also show means of the metrics in the logs.")
    ] = False,
    force: ReplaceOrYes = False,
) -> None:
    """Download logs of a model, or the model itself, from DeepRacer on AWS.

    VIRTUAL_MODEL is packed first, which may take minutes. PHYSICAL_CAR_MODEL is an archive for the
    car.

    Example: dr-droa download 2w7R6h2PNexQ9kC -o logs.tar.gz
    """
    if kind == "EVALUATION_LOGS" and not evaluation:
        raise typer.BadParameter("EVALUATION_LOGS needs --evaluation-id.")
    if summary and not kind.endswith("_LOGS"):
        raise typer.BadParameter("--summary needs logs: TRAINING_LOGS or EVALUATION_LOGS.")
    droa = connection.droa()
    model_id = droa.find(model).model_id
    url = droa_download.find_asset(droa, model_id, kind, evaluation, terminal.waiting)
    file = droa_download.download(
        droa,
        url,
        output or Path(),
        f"{model_id}-{kind.lower()}.tar.gz",
        progress=partial(terminal.progress, unit="bytes"),
        replaces=partial(refuse_existing, force=force),
    )
    report = droa_download.DownloadedAsset(
        droa.place, model_id, kind, str(file), file.stat().st_size
    )
    means = droa_metrics.archive_summary(file) if summary else None
    show(report, means=means)


@app.command("delete")
@connected
def droa_delete_model(connection: Connection, model: _Model, force: _Yes = False) -> None:
    """Delete a model at DeepRacer on AWS. It cannot be restored.

    Only models with status READY or ERROR can be deleted. Asks before; the name of the model is a
    yes too.

    Example: dr-droa delete 2w7R6h2PNexQ9kC -f
    """
    droa = connection.droa()
    found = droa.find(model)
    droa_download.refuse_undeletable(found)
    prompts.agree(
        f"Delete the model {found.name} ({found.model_id}, {found.status}) at {droa.place}? It "
        "cannot be restored.",
        yes=force,
        words=[found.name],
    )
    show(droa_download.delete_model(droa, found))


def _stem(source: Path) -> str:
    name = source.resolve().name
    for end in (".tar.gz", ".tar.bz2", ".tar.xz", ".tgz", ".tar", ".zip"):
        if source.is_file() and name.casefold().endswith(end):
            return name[: -len(end)]
    return name
