"""`dr init`."""

import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import BadValue, ProblemsError, SettingsError, one_of, shown
from drcli.base.installation import lazy_imports
from drcli.base.report import counted
from drcli.cli import completion, prompts, terminal
from drcli.cli.options import force_option, in_options, world_option
from drcli.cli.working_folder import current_folder, working_folder
from drcli.config.race_types import RACE_TYPES

if TYPE_CHECKING:
    from drcli.transfer.ready_made import ReadyMadeModel

with lazy_imports():
    from drcli.checks import compatibility_rules
    from drcli.config import adoption, new_folder, presets, settings, track_names
    from drcli.model import keys
    from drcli.model.files import hyperparameters, model_metadata
    from drcli.transfer import ready_made as transfer_ready_made

OPTIONS = {
    "DR_WORLD_NAME": "--world",
    "DR_RACE_TYPE": "--race-type",
    "DR_LOCAL_S3_MODEL_PREFIX": "--prefix",
    "DR_WORKERS": "--workers",
    "DR_CLOUD": "--cloud",
    "DR_LOCAL_S3_BUCKET": "--bucket",
    "DR_REMOTE_MINIO_URL": "--endpoint",
    "DR_LOCAL_S3_PROFILE": "--profile",
    "DR_EXPERIMENT_NAME": "--experiment",
}

TAUGHT_PRESETS = ("virtual", "unseen")
"""A teacher brings fast laps sooner; to stay on the road is learned as soon without."""

_TRAINABLE = [name for name, race in RACE_TYPES.items() if race.trainable]


def init(
    folder: Annotated[
        str | None,
        typer.Argument(metavar="FOLDER", help="The folder; the current one if left out."),
    ] = None,
    world: Annotated[str | None, world_option("Name of the track.")] = None,
    race_type: Annotated[
        str | None,
        typer.Option(
            "--race-type",
            metavar="TYPE",
            help=f"{', '.join(_TRAINABLE)}, or for evaluations HEAD_TO_MODEL.",
            autocompletion=completion.race_types,
        ),
    ] = None,
    prefix: Annotated[
        str | None, typer.Option("-p", "--prefix", metavar="NAME", help="Name of the model.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", metavar="N", help="Number of simulation workers, 0 to 1,000."),
    ] = None,
    cloud: Annotated[
        str | None,
        typer.Option(
            "-c",
            "--cloud",
            metavar="WHERE",
            help="Where the bucket is: local, remote, aws or azure.",
            autocompletion=completion.clouds,
        ),
    ] = None,
    bucket: Annotated[
        str | None, typer.Option("--bucket", metavar="NAME", help="Name of the bucket.")
    ] = None,
    endpoint: Annotated[
        str | None,
        typer.Option("--endpoint", metavar="URL", help="S3 address for remote and azure."),
    ] = None,
    profile: Annotated[
        str | None,
        typer.Option("--profile", metavar="NAME", help="AWS profile that holds the keys."),
    ] = None,
    experiment: Annotated[
        str | None,
        typer.Option(
            "--experiment",
            metavar="NAME",
            help="Create experiments/NAME/ in a working folder instead.",
            autocompletion=completion.experiments,
        ),
    ] = None,
    curriculum: Annotated[
        bool,
        typer.Option(
            "--curriculum",
            help="Also write curriculum.yaml, an example of a training in stages, and use it.",
        ),
    ] = False,
    preset: Annotated[
        str | None,
        typer.Option(
            "--preset",
            metavar="NAME",
            help="Settings and files for a purpose: virtual, physical and others.",
            autocompletion=completion.presets,
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            metavar="NAME",
            help="Begin with a trained model, such as safe (`dr docs ready-made-models`).",
            autocompletion=completion.ready_made_models,
        ),
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(
            "--example",
            metavar="NAME",
            help="The three files of an example (dr-reward examples), also where a folder exists.",
            autocompletion=completion.examples,
        ),
    ] = None,
    teacher: Annotated[
        bool | None,
        typer.Option(
            "--teacher/--no-teacher",
            help="Train with a teacher that sees the track first (`dr docs teacher`), or without "
            "one.",
        ),
    ] = None,
    adopt: Annotated[
        bool,
        typer.Option(
            "--adopt", help="In a folder of DeepRacer-for-Cloud: replace its bin/activate.sh."
        ),
    ] = False,
    force: Annotated[bool, force_option("Do not ask; replaced files are kept as .bak.")] = False,
    processor: Annotated[str | None, typer.Option("-a", hidden=True)] = None,
    style: Annotated[str | None, typer.Option("-s", hidden=True)] = None,
    mount: Annotated[bool, typer.Option("-m", hidden=True)] = False,
) -> None:
    """Create a working folder: settings, the three files of a model, and bin/activate.sh.

    On a terminal it asks for every value that is not given as an option; otherwise it uses the
    shipped values. No file is replaced unless you agree. `dr config preset` explains the presets.
    With --model, the bucket gets a trained model too, which can be evaluated, trained on, exported
    and sent to the car at once. --adopt writes nothing but bin/activate.sh, and asks about lines of
    ~/.profile (`dr docs from-drfc`).

    Example: dr-init my-racer --world reinvent_base --prefix first-model
    """
    if folder == "":
        raise typer.BadParameter(
            "The name of the folder is empty. Leave it out for the current one."
        )
    if processor or style or mount:
        terminal.say("-a, -s and -m have no effect: they choose docker images and containers.")
    given = (world, race_type, prefix, workers, cloud, bucket, endpoint, profile)
    if adopt:
        if any((*given, experiment, curriculum, preset, model, example, teacher is not None)):
            raise typer.BadParameter("--adopt writes no settings; leave the other options out.")
        _adopt(Path(folder or current_folder()).absolute(), force=force)
        return
    pairs = zip(OPTIONS, given, strict=False)  # all but the experiment
    values = {name: str(value) for name, value in pairs if value is not None}
    tracks = Path(folder or current_folder()) / "tracks"
    if world is not None:
        values["DR_WORLD_NAME"] = _meant(world, tracks)
    chosen = None if preset is None else presets.preset_of(preset)
    ready_made = None if model is None else _ready_made(model)
    if example is not None and model is not None:
        raise typer.BadParameter("--example and --model both bring the three files; use only one.")
    files = None if example is None else presets.example_files(example)
    if ready_made is not None:
        values = transfer_ready_made.values_with(ready_made, values, experiment=experiment)
        files = ready_made.files
    try:
        if experiment is not None:
            plan = new_folder.plan_experiment(
                Path(folder or working_folder()), experiment, values, chosen, files
            )
        elif files is not None and (Path(folder or current_folder()) / "run.env").is_file():
            plan = new_folder.plan_files(Path(folder or current_folder()), files)
        else:
            if prompts.may_ask() and not force:
                values = with_answers(values, prompts.ask, terminal.warn, tracks)
                if teacher is None and ready_made is None and preset != "sac":
                    teacher = wants_teacher(prompts.ask, usually=_is_taught(preset, values))
            plan = new_folder.plan_folder(Path(folder or current_folder()), values, chosen, files)
        if curriculum:
            plan = new_folder.with_curriculum(plan)
        is_new = experiment is None and files is None
        if teacher is None and is_new and _is_taught(preset, values):
            teacher = True
        if teacher is not None:
            plan = hyperparameters.plan_with_method(plan, teacher)
    except ProblemsError as error:
        raise in_options(error, OPTIONS, {*values, "DR_EXPERIMENT_NAME"}) from None
    if plan.clashes and not force:
        there = f"{plan.folder} already has {', '.join(plan.clashes)}."
        if not prompts.may_ask():
            raise typer.BadParameter(f"{there} Add --force to replace this, kept as .bak.")
        prompts.agree(f"{there} Replace this, and keep what it was as .bak?", yes=False)
    if ready_made is not None:
        looking = terminal.waiting("Looking at the bucket ...", only_live=True)
        transfer_ready_made.check_place(plan, experiment, looking)
    report = new_folder.write(plan)
    if ready_made is not None:
        progress = partial(terminal.progress, unit="bytes")
        report = transfer_ready_made.put_into_bucket(report, plan, experiment, ready_made, progress)
    terminal.warn(*report.warnings)
    if report.backups:
        kept = "old file is" if len(report.backups) == 1 else "old files are"
        terminal.warn(f"The {kept} kept as {', '.join(report.backups)}.")
    terminal.emit(report, None)
    kept = f"; {counted(len(report.unchanged), 'file')} kept" if report.unchanged else ""
    _say_where_it_goes(plan)
    terminal.say(f"{counted(len(report.written), 'file')} written to {report.folder}{kept}.")
    sourced = new_folder.has_activate_script(plan.folder)
    if ready_made is not None:
        terminal.say(f"{report.model} is the ready-made model {ready_made.name}.")
        if chosen is not None:
            terminal.say(
                f"Of the preset {chosen.name} only the settings are used: the reward function, the "
                "actions and the hyperparameters are those of the model."
            )
    steps = _next(plan.folder, experiment, plan.missing_track, sourced=sourced)
    after = _AFTER_FILES if ready_made is None else _AFTER_MODEL
    terminal.suggest([*steps, *after], elsewhere=True)


def _adopt(folder: Path, *, force: bool) -> None:
    if not (folder / "run.env").is_file():
        raise SettingsError(
            f"{folder} has no run.env, so it is not a folder of DeepRacer-for-Cloud.",
            remedy="Change to that folder, or create a new one with `dr init`.",
        )
    plan = adoption.plan_adoption(folder)
    if plan.clashes and not adoption.is_reference(folder / new_folder.ACTIVATE) and not force:
        there = f"{folder} has a {new_folder.ACTIVATE} that is not DeepRacer-for-Cloud's."
        prompts.agree(f"{there} Replace it, and keep what it was as .bak?", yes=False)
    report = new_folder.write(plan)
    lines = adoption.login_lines(Path("~").expanduser())
    mended = None
    if lines and _may_mend(folder, lines, force=force):
        mended = new_folder.write(adoption.plan_logins(folder, lines))
    elif lines:
        told = "; ".join(f"{line} (source {line.script})" for line in lines)
        terminal.warn(
            f"New shells still load the functions of DeepRacer-for-Cloud: {told}. "
            "`dr-init --adopt --yes` changes that."
        )
    pairs = [] if mended is None else [(mended, name) for name in mended.written]
    places = [(report, name) for name in report.written] + pairs
    for written, name in places:
        terminal.say(f"{Path(written.folder, name)} sets up the dr-* programs now.")
    kept = [(each, name) for each in (report, mended) if each is not None for name in each.backups]
    for each, name in kept:
        old, new = (shlex.quote(str(Path(each.folder, n))) for n in (name, _unkept(name)))
        terminal.say(f"To undo this: mv {old} {new}")
    if not places:
        terminal.say(f"{folder} is adopted already; nothing was changed.")
    terminal.emit(report, None)
    here = [] if folder.samefile(".") else [(f"cd {shlex.quote(str(folder))}", "go to the folder")]
    activate = ("source bin/activate.sh", "also in shells that are open")
    steps = [*here, activate, ("dr-config check", "check everything")]
    if (folder / "data/minio").is_dir():
        steps.append(("dr-list-models", "see whether models lie in data/minio"))
    terminal.suggest(steps, elsewhere=True)


def _may_mend(folder: Path, lines: Sequence["adoption.LoginLine"], *, force: bool) -> bool:
    if force or not prompts.may_ask():
        return force
    told = " and ".join(map(str, lines))
    question = (
        f"{told}: each new shell loads DeepRacer-for-Cloud's functions. Load {folder} instead"
    )
    return prompts.ask(question, "yes", ("yes", "no")) == "yes"


def _unkept(backup: str) -> str:
    return re.sub(r"\.bak\d*$", "", backup)


def _say_where_it_goes(plan: "new_folder.FolderPlan") -> None:
    for file in plan.files:
        if file.name.endswith(keys.MODEL_METADATA_FILE):
            metadata = model_metadata.ModelMetadata.from_bytes(file.data, file.name)
            terminal.say(compatibility_rules.destinations(metadata))


def _is_taught(preset: str | None, values: Mapping[str, str]) -> bool:
    return preset in TAUGHT_PRESETS and values.get("DR_RACE_TYPE", "TIME_TRIAL") == "TIME_TRIAL"


_AFTER_FILES = (("dr-validate", "check everything"), ("dr-start-training", "train"))
_AFTER_MODEL = (
    ("dr-evaluate", "drive it"),
    ("dr-increment-training && dr-start-training", "train on, as a new model"),
    ("dr-export car", "make the archive for the physical car"),
)


def _ready_made(name: str) -> "ReadyMadeModel":
    names = presets.ready_made()
    if name not in names:
        raise typer.BadParameter(
            f"--model {shown(name)}: there is no such ready-made model. {one_of(names, name)}"
        )
    return transfer_ready_made.read_ready_made(name)


def with_answers(
    given: Mapping[str, str],
    ask: Callable[[str, str, Sequence[str]], str],
    warn: Callable[[str], None],
    tracks_folder: Path = Path("tracks"),
) -> dict[str, str]:
    """The settings that were given, and the answers to all other questions.

    Args:
        given: Texts by DR_ name; these questions are not asked.
        ask: Takes a question, a default and the allowed words, and returns the answer.
        warn: Prints what is wrong with an answer, before the question is asked again.
        tracks_folder: With the racer's own tracks.
    """
    values = dict(given)

    def ask_for(name: str, question: str, default: str, choices: Sequence[str] = ()) -> None:
        unsure = ""
        while name not in values:
            answer, odd = ask(question, default, choices), None
            if name == "DR_WORLD_NAME":
                answer = _meant(answer, tracks_folder)
                odd = track_names.unknown_track(answer, tracks_folder)
            if odd and answer != unsure:
                unsure = answer
                warn(f"{odd} To add a track of this name later, give it again.")
                continue
            try:
                settings.catalogue()[name].read(answer)
            except BadValue as bad:
                warn(f"{shown(answer)} {bad.reason}. {bad.remedy}")
            else:
                values[name] = answer

    clouds = completion.clouds()
    ask_for("DR_WORLD_NAME", "Track (`dr-tracks list --all` shows them)", "reinvent_base")
    ask_for("DR_RACE_TYPE", "Race", _TRAINABLE[0], _TRAINABLE)
    ask_for("DR_LOCAL_S3_MODEL_PREFIX", "Name of the model", "rl-deepracer-sagemaker")
    ask_for("DR_CLOUD", "Where the bucket is", clouds[0], clouds)
    if values["DR_CLOUD"] != "local":
        if values["DR_CLOUD"] in ("remote", "azure"):
            ask_for("DR_REMOTE_MINIO_URL", "S3 address", "http://localhost:9000")
        ask_for("DR_LOCAL_S3_BUCKET", "Name of the bucket", "bucket")
        ask_for("DR_LOCAL_S3_PROFILE", "AWS profile that holds the keys", "default")
    return values


def _meant(world: str, tracks_folder: Path) -> str:
    meant = track_names.meant(world, tracks_folder)
    if meant != world:
        terminal.say(f"{shown(world)} is the track {meant}.")
    return meant


def wants_teacher(ask: Callable[[str, str, Sequence[str]], str], *, usually: bool) -> bool:
    """The answer to the question whether a teacher comes first, which is `usually` this."""
    question = "Learn from a teacher that sees the track first (`dr docs teacher`)"
    return ask(question, "yes" if usually else "no", ("yes", "no")) == "yes"


def _next(
    folder: Path, experiment: str | None, missing_track: str | None, *, sourced: bool
) -> list[tuple[str, str]]:
    steps = [] if folder.samefile(".") else [(f"cd {shlex.quote(str(folder))}", "go to the folder")]
    active = os.environ.get("DR_DIR")
    if experiment is not None and sourced:
        steps.append((f"source bin/activate.sh -e {experiment}", "use the experiment"))
    elif experiment is not None:
        here = f"DR_DIR={shlex.quote(str(folder))}"
        steps.append((f"export {here} DR_EXPERIMENT_NAME={experiment}", "use the experiment"))
    elif active and Path(active).absolute() != folder:
        leave = "unset DR_EXPERIMENT_NAME; source bin/activate.sh"
        steps.append((leave, f"leave {active}"))
    if missing_track is not None:
        steps.append((f"dr-tracks fetch {missing_track}", "fetch the track"))
    return steps
