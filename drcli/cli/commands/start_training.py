"""`dr start-training`."""

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drcli.base.errors import WorkerDied
from drcli.base.installation import lazy_imports
from drcli.base.processes import Interrupted
from drcli.cli import follow_training, prompts, terminal, training_display
from drcli.cli.evaluation_options import with_options
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import (
    Force,
    checkpoint_option,
    parsed_checkpoint,
    prefix_option,
    wipe_option,
)
from drcli.cli.working_folder import settings
from drcli.model.model_store import ModelStore
from drcli.train.goals import OPTIONS

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.run.plan import EndWorkPlan, RunPlan, StartOptions

with lazy_imports():
    from drcli.bucket import connect
    from drcli.model import lease, model_prefix
    from drcli.model.files import hyperparameters
    from drcli.records import run_record
    from drcli.run import early_training, plan, status, training
    from drcli.run import resume_or_start as run_resume_or_start
    from drcli.transfer import transfer_buckets


_LONGEST_MINUTES = 10_000_000


def _a_number(minutes: float | None) -> float | None:
    """NaN passes comparisons with limits."""
    if minutes is not None and math.isnan(minutes):
        raise typer.BadParameter("nan is not a number of minutes.")
    return minutes


def _goal(key: str) -> Any:
    option = OPTIONS[key]
    return typer.Option(
        min=option.low,
        max=option.high,
        callback=None if option.whole else _a_number,
        metavar=option.metavar,
        help=option.help,
    )


def start_training(
    wipe: Annotated[bool, wipe_option("Delete everything under the model prefix first.")] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the training of this model.")
    ] = False,
    resume_or_start: Annotated[
        bool,
        typer.Option(
            "--resume-or-start",
            help="Start, continue, or do nothing if the training is complete or was stopped on "
            "purpose. Can be given again and again, on any machine.",
        ),
    ] = False,
    no_wait: Annotated[
        bool,
        typer.Option(
            "--no-wait",
            help="With --resume-or-start: exit 9 if another machine trains the model, instead of "
            "waiting for its end.",
        ),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Return at once and print one line.")
    ] = False,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="Show more numbers.")] = False,
    trainer_log: Annotated[
        bool, typer.Option("-s", help="Follow the trainer's log instead of the display.")
    ] = False,
    worker_log: Annotated[
        bool, typer.Option("-r", help="Follow the log of simulation worker N instead.")
    ] = False,
    all_logs: Annotated[bool, typer.Option("-a", help="Follow all logs instead.")] = False,
    worker: Annotated[
        int | None, typer.Argument(metavar="N", min=0, help="Number of the worker for -r, from 0.")
    ] = None,
    foreground: Annotated[
        bool, typer.Option("--foreground", help="Run the training in this process.")
    ] = False,
    max_minutes: Annotated[
        float | None,
        typer.Option(
            "--max-minutes",
            min=0.01,
            max=_LONGEST_MINUTES,
            callback=_a_number,
            metavar="M",
            help="Stop after M minutes.",
        ),
    ] = None,
    until_laps: Annotated[int | None, _goal("until_laps")] = None,
    until_lap_time: Annotated[float | None, _goal("until_lap_time_s")] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            min=0,
            max=2**32 - 1,
            metavar="S",
            help="Seed, to repeat a training exactly.",
        ),
    ] = None,
    pretrained: Annotated[
        str | None,
        prefix_option("Start with the weights of this model.", "--pretrained"),
    ] = None,
    checkpoint: Annotated[
        str | None, checkpoint_option("Start with the weights of", "--checkpoint")
    ] = None,
    teacher: Annotated[
        bool | None,
        typer.Option(
            "--teacher/--no-teacher",
            help="Train with a teacher that sees the track first, or without one, whatever "
            "training_method says.",
        ),
    ] = None,
    on_end: Annotated[
        str | None,
        typer.Option(
            "--on-end",
            metavar="CMD",
            help="Run this command of the shell when the training has ended (DR_ON_END).",
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Train the model that run.env describes.

    Uses reward_function.py, hyperparameters.json and model_metadata.json from custom_files/, or
    from the bucket, or the shipped examples if you have none. Everything is checked first.

    A terminal shows a live display. Ctrl-C leaves it and the training continues; dr-attach shows it
    again. Otherwise, one line is printed for each iteration. The command exits when the training
    ends, with the same exit code. With -q it returns at once.

    On a terminal, -w asks before it deletes a model; -f answers yes.

    --pretrained and --checkpoint replace the DR_LOCAL_S3_PRETRAINED settings for this start: the
    new model begins with the weights of another one.

    With --resume-or-start, --max-minutes counts the time of all starts together, and a training
    that SIGTERM or the cloud ends exits 75: it can be resumed. Without a terminal it also downloads
    community tracks that are not installed, unless DR_TRACKS_FETCH is never.

    --teacher writes "training_method": "teacher" into the model, not into custom_files/: a resume
    and a new model with its weights keep it until --no-teacher (`dr docs teacher`).

    --until-lap-time asks for five evaluation laps at least, or for as many as --until-laps says.
    DR_TRAIN_EVAL_LAPS (20) are driven, and all must hold it. A checkpoint that does drives 40 more
    laps from other starts, of which 38 must hold it, too.

    Example: dr-start-training --until-laps 3
    """
    if no_wait and not resume_or_start:
        raise typer.BadParameter("--no-wait needs --resume-or-start.")

    with _checking():
        loaded = _with_weights(settings(), pretrained, checkpoint, resume=resume)
        if on_end is not None:
            loaded = loaded.replaced(on_end=on_end)
    followed = _followed(loaded, trainer_log, worker_log, all_logs, worker)
    how = _How(quiet, verbose, foreground, followed)
    with nullcontext() if foreground or resume_or_start else early_training.begun(loaded):
        patience_s = connect.OUTAGE_PATIENCE_S if resume_or_start and not no_wait else 0.0
        bring_tracks(loaded, unattended=resume_or_start, patience_s=patience_s)
        if wipe and not (resume or resume_or_start) and not force and prompts.may_ask():
            _agree_to_wipe(loaded)
        asked = {"until_laps": until_laps, "until_lap_time_s": until_lap_time}
        with _checking():  # here already, because the libraries of a plan take a second to load
            options = plan.StartOptions(
                wipe,
                resume,
                max_minutes,
                seed,
                goals={key: value for key, value in asked.items() if value is not None},
                method=None if teacher is None else hyperparameters.method_of(teacher),
            )
        if not resume_or_start:
            raise typer.Exit(_run(loaded, _planned(loaded, options), how))
        raise typer.Exit(_resume_or_start(loaded, options, how, wait=not no_wait))


def _with_weights(
    loaded: "Settings", pretrained: str | None, checkpoint: str | None, *, resume: bool
) -> "Settings":
    choice = parsed_checkpoint(checkpoint)
    if pretrained is None and choice is None:
        return loaded
    if resume:
        raise typer.BadParameter(
            "--pretrained and --checkpoint choose the weights of a new model; --resume continues "
            "with the newest checkpoint. To go back to another one, make a new model from it with "
            "`dr-increment-training --checkpoint N`."
        )
    if pretrained is None and not loaded.pretrained:
        raise typer.BadParameter(
            "--checkpoint chooses one of another model, but DR_LOCAL_S3_PRETRAINED is False. Name "
            "the model with --pretrained PREFIX."
        )
    if pretrained is not None:
        prefix = transfer_buckets.checked_prefix(pretrained, "--pretrained")
        loaded = with_options(
            loaded, DR_LOCAL_S3_PRETRAINED=True, DR_LOCAL_S3_PRETRAINED_PREFIX=prefix
        )
    return with_options(loaded, DR_LOCAL_S3_PRETRAINED_CHECKPOINT=choice)


def _agree_to_wipe(loaded: "Settings") -> None:
    prefix = loaded.model_prefix
    bucket = connect.open_bucket(loaded.storage, patience_s=connect.COMMAND_PATIENCE_S)
    model = ModelStore(bucket, prefix)
    if not model_prefix.is_used(model):
        return
    newest = model_prefix.newest_checkpoint(model)
    learned = "no checkpoint" if newest is None else f"checkpoints up to {newest.number}"
    question = f"Delete s3://{bucket.name}/{prefix}, which has {learned}? It cannot be undone."
    prompts.agree(question, yes=False)


@dataclass(frozen=True)
class _How:
    quiet: bool
    verbose: bool
    foreground: bool
    followed: list[str]


@contextmanager
def _waiting(what: str, interrupted: str) -> Iterator[None]:
    try:
        with terminal.waiting(what, only_live=True):
            yield
    except KeyboardInterrupt:
        raise Interrupted(interrupted, remedy="") from None


def _checking() -> AbstractContextManager[None]:
    what = "Checking settings, files and reward function ..."
    return _waiting(what, "Interrupted; no training was started.")


def _planned(loaded: "Settings", options: "StartOptions") -> "RunPlan":
    with _checking():
        return plan.prepare(loaded, options)


def _resume_or_start(loaded: "Settings", options: "StartOptions", how: _How, *, wait: bool) -> int:
    while True:
        planned = run_resume_or_start.prepare_next(loaded, options, wait=wait)
        if isinstance(planned, run_resume_or_start.NothingToDo):
            terminal.say(planned.sentence)
            terminal.emit(status.inspect(loaded.run), None)
            return 0
        try:
            return _run(loaded, planned, how)
        except (lease.ModelInUse, WorkerDied):
            if not run_resume_or_start.was_overtaken(loaded, planned.job):
                raise


def _run(loaded: "Settings", planned: "RunPlan | EndWorkPlan", how: _How) -> int:
    quiet, verbose, foreground = how.quiet, how.verbose, how.foreground
    followed, folder = how.followed, loaded.directory
    if not quiet:
        if isinstance(planned, plan.RunPlan):
            terminal.warn(*planned.warnings)
            terminal.say(training_display.start_text(planned))
        else:
            terminal.say(training_display.end_work_text(planned))

    if quiet:
        display = follow_training.nothing()
    elif followed:
        display = follow_training.logs(
            {name: run_record.log_file(folder, loaded.model_prefix, name) for name in followed}
        )
    else:
        display = follow_training.suitable(loaded.run, verbose=verbose, screen=not foreground)

    if foreground:
        with follow_training.meanwhile(loaded.run, display):
            ended_with = training.supervise_job(planned.job)
        report = status.inspect(loaded.run)
        if not follow_training.is_over(report):
            report = replace(
                report,
                state="failed" if ended_with else "finished",
                exit_code=ended_with,
                message="The training has ended, but the record of its end could not be written.",
                remedy="Read how it ended with `dr-logs supervisor`.",
            )
        code = follow_training.end(report, loaded.model_prefix)
    else:
        unknown = "Interrupted while the workers started; `dr-status` says whether they run."
        with _waiting("Starting the workers ...", unknown):
            pid = training.launch(planned)
        if status.inspect(loaded.run).pid != pid:
            raise WorkerDied(
                "The training did not start.", remedy="Read the reason with `dr-logs supervisor`."
            )
        if quiet:
            terminal.say(f"Training of model s3://{loaded.bucket}/{loaded.model_prefix} starting.")
            if terminal.as_json:
                terminal.emit(status.inspect(loaded.run), None)
            return 0
        if followed or not terminal.is_live():  # else the display has this room
            terminal.suggest(follow_training.NEXT)
        code = follow_training.follow(loaded.run, display, loaded.model_prefix)
    return code


def _followed(
    loaded: "Settings", trainer: bool, sim: bool, everything: bool, worker: int | None
) -> list[str]:
    if worker is not None and not sim:
        raise typer.BadParameter("A number needs -r, as in `dr-start-training -r 1`.")
    if sim and not loaded.workers:
        raise typer.BadParameter("-r: DR_WORKERS is 0, so no simulation worker runs here.")
    if worker is not None and worker >= loaded.workers:
        raise typer.BadParameter(f"-r {worker}: DR_WORKERS is {loaded.workers}; counted from 0.")
    sims = [f"sim-{k}" for k in range(loaded.workers)]
    if everything:
        return ["trainer", *sims]
    return ["trainer"] * trainer + [f"sim-{worker or 0}"] * sim
