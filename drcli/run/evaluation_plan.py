"""Plans an evaluation: checkpoints and parameter file."""

import os
import secrets
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.base.errors import ProblemsError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.config.track_names import track_problem
from drcli.config.value_types import parse_checkpoint
from drcli.convert.engines import RUNS, check_runtime
from drcli.convert.policy_file import read_policy_file
from drcli.model import keys
from drcli.model.checkpoint_choice import ModelCheckpoints
from drcli.model.files.params_yaml import evaluation_parameters
from drcli.model.growing_file import list_parts
from drcli.model.model_prefix import what_helps
from drcli.model.model_store import ModelStore
from drcli.model.repair import repair_unless_trained
from drcli.model.write_probe import prove_writing
from drcli.records.evaluation_task import PolicySource, Runtime
from drcli.records.job import Job
from drcli.records.run_record import claim, sweep
from drcli.view.video.encode import require_encoder

with lazy_imports():
    from drcli.convert import runtimes

CHECKPOINT = PolicySource()
CLONE_SUFFIX = "-E"


@dataclass(frozen=True)
class EvaluationPlan:
    """An evaluation that passed all checks.

    Attributes:
        checkpoints: The model's, and the HEAD_TO_MODEL opponent's; or names of files.
        stamp: Its name, the time as fourteen digits.
    """

    job: Job
    checkpoints: list[str]
    stamp: str

    @property
    def simtrace(self) -> str:
        return keys.evaluation_trace(self.job.config.model.prefix, self.stamp)

    @property
    def metrics(self) -> str:
        return keys.evaluation_metrics(self.job.config.model.metrics_prefix, self.stamp)


def prepare_evaluation(
    settings: Settings,
    *,
    clone: bool = False,
    seed: int | None = None,
    own: PolicySource = CHECKPOINT,
    opponent: PolicySource | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> EvaluationPlan:
    """Choose the checkpoints, and describe the evaluation in the bucket.

    Raises:
        SettingsError: The track, model or checkpoint does not exist, or a file cannot drive.
        NotAvailable: The engine of a policy, or the encoder of videos, is not installed.
    """
    if opponent is not None and settings.race_type != "HEAD_TO_MODEL":
        raise SettingsError(
            f"An opponent drives only in a HEAD_TO_MODEL race, but DR_RACE_TYPE is "
            f"{settings.race_type}.",
            remedy="Set DR_RACE_TYPE=HEAD_TO_MODEL, or leave out the options of the opponent.",
        )
    offset = settings.eval_start_offset
    if settings.race_type == "HEAD_TO_MODEL" and offset != "centre":
        raise SettingsError(
            f"DR_EVAL_START_OFFSET={offset} ({settings.source('DR_EVAL_START_OFFSET')}) cannot be "
            "kept in a HEAD_TO_MODEL race, where the cars start side by side.",
            remedy="Write DR_EVAL_START_OFFSET=centre, or leave it out.",
        )
    if settings.eval_save_mp4:
        require_encoder()
    sources = [checked_source(own), checked_source(opponent or CHECKPOINT)]
    directory = settings.directory
    track = track_problem(settings.race)
    if track is not None:  # also one that could be fetched: an evaluation needs it now
        raise ProblemsError([replace(track, severity="error")])
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    if own.file is None:
        repair_unless_trained(
            ModelStore.of(settings.model, bucket, settings.model_prefix), missing=True
        )
        check_model(ModelStore(bucket, settings.model_prefix), "DR_LOCAL_S3_MODEL_PREFIX")
        on_progress(f"Evaluation of model s3://{bucket.name}/{settings.model_prefix} starting.")
    else:
        on_progress(f"Evaluation of {own.file} starting.")
    if clone:
        settings = _cloned(settings, bucket)
        on_progress(f"Cloning model into s3://{bucket.name}/{settings.model_prefix}")
    choice = settings.eval_checkpoint
    prefix = settings.model_prefix
    checkpoints = [
        _driven(settings, ModelStore(bucket, prefix), choice, own, "--checkpoint", on_progress)
    ]
    if settings.race_type == "HEAD_TO_MODEL":
        theirs = settings.eval_opp_s3_model_prefix
        if sources[1].file is None:
            repair_unless_trained(ModelStore.of(settings.model, bucket, theirs), missing=True)
            check_model(ModelStore(bucket, theirs), "DR_EVAL_OPP_S3_MODEL_PREFIX")
        choice = settings.eval_opp_checkpoint or choice
        option = "--opp-checkpoint"
        found = _driven(
            settings, ModelStore(bucket, theirs), choice, sources[1], option, on_progress
        )
        checkpoints.append(found)
    on_progress(f"Evaluating {' against '.join(checkpoints)} on {settings.world_name} ...")
    sweep(directory, settings.run_id)
    stamp, folder = claim_stamp(settings, bucket, directory)
    parameters = evaluation_parameters(
        settings,
        keys.folder(settings.model_prefix) + f"evaluation-{stamp}",
        keys.evaluation_metrics(settings.metrics_prefix, stamp),
        keys.opponent_metrics(settings.eval_opp_s3_metrics_prefix, stamp),
    )
    try:
        key = keys.parameter_file(settings.model_prefix, settings.eval_params_file)
        bucket.put(key, parameters)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    job = evaluation_job(settings, folder, seed)
    job = replace(job, sources=tuple(sources[: len(checkpoints)]))
    return EvaluationPlan(job, checkpoints, stamp)


def evaluation_job(settings: Settings, folder: Path, seed: int | None) -> Job:
    return Job(
        config=settings.run,
        session=secrets.token_hex(6),
        seed=seed if seed is not None else settings.train_seed or 0,
        max_minutes=None,
        folder=folder,
        launcher_pid=os.getpid(),
    )


def checked_source(source: PolicySource) -> PolicySource:
    if source.file is None:
        runtime: Runtime = source.runtime or "torch"
        if runtime != "torch":
            check_runtime("pb", runtime, "a checkpoint")
        return replace(source, runtime=runtime)
    file = read_policy_file(source.file, source.metadata)
    runtime = source.runtime or RUNS[file.form][0]
    runtimes.check_file(file, runtime)
    return replace(source, runtime=runtime, sha256=file.sha256)


def _driven(
    settings: Settings,
    model: ModelStore,
    choice: str,
    source: PolicySource,
    option: str,
    on_progress: Callable[[str], None],
) -> str:
    if source.file is not None:
        return source.file.name
    checkpoints = _checkpoints(settings, model)
    chosen = checkpoints.choose(parse_checkpoint(choice))
    on_progress(checkpoints.sentence_about(chosen, option))
    return chosen.name


def check_model(model: ModelStore, setting: str) -> None:
    """Raise SettingsError unless a prefix, which `setting` names, has a trained model."""
    needed = (keys.model_metadata(model.prefix), keys.deepracer_checkpoints(model.prefix))
    for key in needed:
        if not model.bucket.exists(key):
            raise SettingsError(
                f"{model.url} has no trained model: {key} is missing.",
                remedy=what_helps(model, setting=setting),
            )


def choose_checkpoint(settings: Settings, model: ModelStore) -> str:
    """The one of DR_EVAL_CHECKPOINT; SettingsError if the model has none."""
    choice = parse_checkpoint(settings.eval_checkpoint)
    return _checkpoints(settings, model).choose(choice).name


def _checkpoints(settings: Settings, model: ModelStore) -> ModelCheckpoints:
    checkpoints = ModelCheckpoints.read(ModelStore.of(settings.model, model.bucket, model.prefix))
    if checkpoints.scores is None:
        raise SettingsError(f"{model.url} has no checkpoint yet.", remedy=what_helps(model))
    return checkpoints


def _cloned(settings: Settings, bucket: Bucket) -> Settings:
    """Copies the model, its pointers last."""
    source, target = settings.model_prefix, settings.model_prefix + CLONE_SUFFIX
    pointers = (keys.deepracer_checkpoints(source), keys.coach_checkpoint(source))
    found = [
        item.key
        for folder in ("model/", "ip/")
        for item in bucket.list(keys.folder(source) + folder)
    ]
    history = keys.history(source)  # tells how its checkpoints drove
    found += [history] * bucket.exists(history) + list_parts(bucket, history)
    prove_writing(ModelStore(bucket, target), deletes=False)
    for key in sorted(found, key=lambda key: key in pointers):
        copy = keys.folder(target) + key.removeprefix(keys.folder(source))
        bucket.put(copy, bucket.get(key))
    return settings.replaced(model_prefix=target, metrics_prefix=keys.metrics_prefix(target))


def claim_stamp(settings: Settings, bucket: Bucket, directory: Path) -> tuple[str, Path]:
    """A unique name, and its folder; two may start in one second."""
    at = time.time()
    while True:
        stamp = time.strftime("%Y%m%d%H%M%S", time.localtime(at))
        if not bucket.exists(keys.evaluation_trace(settings.model_prefix, stamp)):
            folder = claim(directory, settings.run_id, stamp)
            if folder is not None:
                return stamp, folder
        at += 1.0
