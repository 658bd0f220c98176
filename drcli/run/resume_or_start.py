"""Starts or resumes a run, or does nothing: whatever its model asks for."""

from dataclasses import dataclass, replace

from drcli.base.errors import NoAnswer, NoKeys, NotYet, SettingsError
from drcli.bucket.connect import COMMAND_PATIENCE_S, OUTAGE_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.model import lease
from drcli.model.model_prefix import ModelListing, is_aborted_start
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome
from drcli.records.job import Job
from drcli.records.run_record import run_folder
from drcli.records.training_record import RunOutcome
from drcli.run.outcome import INTERRUPTED
from drcli.run.plan import EndWorkPlan, RunPlan, StartOptions, goals_of, prepare, prepare_end_work
from drcli.run.planned_stages import parameter_files
from drcli.run.take_model import OwnerWait
from drcli.train.goals import same_goals


@dataclass(frozen=True)
class NothingToDo:
    sentence: str


Next = RunPlan | EndWorkPlan | NothingToDo


def prepare_next(settings: Settings, options: StartOptions, *, wait: bool) -> Next:
    """Plan what is to be done, once nobody else trains the model.

    `wait` for a living owner, and for server and keys that may be missing while a machine
    boots.

    Raises:
        TrainedElsewhere: The owner lives, without `wait`.
        SettingsError: Something is wrong.
        NotYet: Bucket or keys did not come.
        StorageError: The bucket cannot be used.
    """
    if options.wipe or options.resume:
        given = "-w" if options.wipe else "--resume"
        raise SettingsError(
            f"--resume-or-start and {given} cannot be combined.",
            remedy="Leave one of them out: -w deletes the model, --resume continues it in any "
            "case, --resume-or-start continues what was not ended on purpose.",
        )
    folder = run_folder(settings.directory, settings.run_id)
    options = replace(options, whole_run=True)
    patience_s = OUTAGE_PATIENCE_S if wait else COMMAND_PATIENCE_S
    while True:
        bucket = open_bucket(settings.storage, patience_s=patience_s, unattended=wait)
        model = ModelStore(bucket, settings.model_prefix)
        try:
            OwnerWait(model, folder, wait).until_free()
        except (NoAnswer, NoKeys) as error:
            if not wait:
                raise
            raise NotYet(str(error), remedy=error.remedy) from error
        try:
            return _plan(settings, options, model)
        except lease.ModelInUse:
            if lease.live_holder(model) is None:
                raise  # this DR_RUN_ID trains another model here


def was_overtaken(settings: Settings, job: Job) -> bool:
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    held = lease.live_holder(ModelStore(bucket, settings.model_prefix))
    return held is not None and held.session != job.session


def _plan(settings: Settings, options: StartOptions, model: ModelStore) -> Next:
    listed = ModelListing(model)
    if not listed.objects:
        return prepare(settings, options)
    outcome = read_outcome(model)
    if outcome is not None and outcome.stays_ended:
        return NothingToDo(_stays_ended(outcome, model.url))
    if outcome is not None and outcome.state == "finished":
        if same_goals(outcome.goals, goals_of(settings, options, outcome, model)):
            if outcome.left:
                return prepare_end_work(settings, outcome, model)
            return NothingToDo(
                f"Nothing to do for {model.url}: {outcome.message} To go on, raise the goals in "
                "run.env or hyperparameters.json."
            )
        return prepare(settings, replace(options, resume=True))
    if listed.has_checkpoint:
        return prepare(settings, replace(options, resume=True))
    if is_aborted_start(listed, parameter_files(settings)):
        return prepare(settings, replace(options, over_aborted=True))
    return prepare(settings, options)  # which explains what is in the way


def _stays_ended(outcome: RunOutcome, model: str) -> str:
    why = "its machine was taken away" if outcome.code == INTERRUPTED else "somebody stopped it"
    also = ", and DR_CONTINUE_ON_SPOT_INTERRUPTION is False" if outcome.code == INTERRUPTED else ""
    return (
        f"The training of {model} stays stopped: {why}{also}. "
        "Continue it with `dr-start-training --resume`."
    )
