"""Plans evaluations that share workers: models, tracks, or a grid."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.base.errors import DrError, SettingsError
from drcli.base.problems import BadValue, Place, ProblemsError
from drcli.config.checkpoint_words import CheckpointChoice, parse_checkpoint
from drcli.config.settings import Settings
from drcli.config.track_names import track_problem
from drcli.exchange.evaluation_record import claim, sweep
from drcli.exchange.evaluation_task import EvaluationTask
from drcli.exchange.job import Job
from drcli.exchange.policy_source import PolicySource
from drcli.models.model_list import fits, model_prefixes
from drcli.runs.evaluation_plan import (
    check_model,
    checked_source,
    choose_checkpoint,
    evaluation_job,
)
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket


@dataclass(frozen=True)
class Refused:
    prefix: str
    reason: str
    remedy: str


@dataclass(frozen=True)
class ManyPlan:
    job: Job
    stamp: str
    worlds: list[str]
    refused: list[Refused] = field(default_factory=list)
    compares: bool = False


@dataclass(frozen=True)
class Rival:
    prefix: str | None
    choice: CheckpointChoice = "best"

    @staticmethod
    def parse(text: str) -> "Rival":
        """Read CHECKPOINT, PREFIX or PREFIX:CHECKPOINT; BadValue if it is none."""
        with suppress(BadValue):
            return Rival(None, parse_checkpoint(text))
        prefix, colon, choice = text.strip().partition(":")
        prefix = prefix.strip("/")
        if not prefix:
            raise BadValue(
                "names neither a checkpoint nor a model",
                "Write the number of a checkpoint, a word such as last, or the prefix of a model.",
            )
        return Rival(prefix, parse_checkpoint(choice)) if colon else Rival(prefix)


def prepare_many(
    settings: Settings,
    *,
    models: Sequence[str] = (),
    worlds: Sequence[str] = (),
    robust: bool = False,
    fresh_laps: int = 0,
    rival: Rival | None = None,
    seed: int | None = None,
    own: PolicySource | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> ManyPlan:
    """Find the models and their checkpoints, before a process starts.

    Args:
        settings: Describe the race in DR_EVAL_*.
        models: Prefixes, perhaps with `*` and `?`.
        worlds: Tracks; none for that of the settings.
        robust: Drive the grid of disturbances.
        fresh_laps: Laps from fresh starts instead of the trials.
        rival: Drives from the same starts; only without `models` and `worlds`.
        seed: Of all random numbers.
        own: What drives; only without `models`.
        on_progress: Shows sentences.

    Raises:
        SettingsError: A track does not exist, no model fits, or the only one cannot drive.
    """
    if settings.race_type == "HEAD_TO_MODEL":
        raise SettingsError(
            "DR_RACE_TYPE=HEAD_TO_MODEL races two models, but here each model drives alone.",
            remedy="Choose another DR_RACE_TYPE, or run `dr-evaluate` without --models, --worlds, "
            "--robust and --laps.",
        )
    worlds = list(dict.fromkeys(worlds)) or [settings.world_name]
    for world in worlds:
        problem = track_problem(on_world(settings, world).race)
        if problem is not None:
            raise ProblemsError([replace(problem, severity="error")])
    source = checked_source(own or PolicySource())
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    prefixes = matching_models(bucket, models) if models else [settings.model_prefix]
    chosen: dict[str, str] = {}
    refused: list[Refused] = []
    for prefix in prefixes:
        try:
            if source.file is None:
                check_model(bucket, prefix, "--models" if models else "DR_LOCAL_S3_MODEL_PREFIX")
                chosen[prefix] = choose_checkpoint(settings, bucket, prefix)
            else:
                chosen[prefix] = source.file.name
        except DrError as error:
            if not models:
                raise
            refused.append(Refused(prefix, str(error), error.remedy))
    entrants = [
        (prefix, chosen[prefix], world, index, source)
        for index, world in enumerate(worlds)
        for prefix in chosen
    ]
    if rival is not None:
        prefix, checkpoint = _rival(settings, bucket, rival, entrants[0])
        # Its stamp is a second later, because it may be the same model.
        engine = source if source.file is None else checked_source(PolicySource())
        entrants.append((prefix, checkpoint, worlds[0], 1, engine))
    sweep(settings.directory, settings.run_id)
    stamp, folder = _claimed(settings)
    tasks = [
        EvaluationTask(
            number=number,
            prefix=prefix,
            metrics_prefix=_metrics_prefix(settings, prefix),
            checkpoint=checkpoint,
            world=world,
            stamp=_free_stamp(bucket, prefix, stamp, index),
            source=driver,
            robust=robust,
            fresh_laps=fresh_laps,
        )
        for number, (prefix, checkpoint, world, index, driver) in enumerate(entrants)
    ]
    if tasks:
        on_progress(_announced(tasks, worlds))
    job = replace(evaluation_job(settings, folder, seed), tasks=tuple(tasks))
    return ManyPlan(job, stamp, worlds, refused, compares=rival is not None)


def _rival(
    settings: Settings, bucket: Bucket, rival: Rival, own: tuple[str, str, str, int, PolicySource]
) -> tuple[str, str]:
    prefix = rival.prefix or settings.model_prefix
    check_model(bucket, prefix, "--against")
    asked = settings.replaced(eval_checkpoint=str(rival.choice))
    checkpoint = choose_checkpoint(asked, bucket, prefix)
    if (prefix, checkpoint) == own[:2] and own[-1].file is None:
        raise SettingsError(
            f"--against chooses {checkpoint} of {prefix}, which drives anyway.",
            remedy="Choose another checkpoint, as in --against last; `dr-list-checkpoints` lists "
            "them.",
        )
    return prefix, checkpoint


def on_world(settings: Settings, world: str) -> Settings:
    if world == settings.world_name:
        return settings
    sources = {**settings.sources, "DR_WORLD_NAME": Place("flag")}
    return settings.replaced(world_name=world, sources=sources)


def matching_models(bucket: Bucket, patterns: Sequence[str]) -> list[str]:
    """Sorted; SettingsError if a pattern fits none."""
    known = model_prefixes(bucket)
    found: set[str] = set()
    for pattern in patterns:
        fitting = {prefix for prefix in known if fits(prefix, pattern)}
        if not fitting:
            some = ", ".join(sorted(known)[:5]) or "no models at all"
            raise SettingsError(
                f"No model in s3://{bucket.name} fits --models {pattern!a}; it has {some}.",
                remedy="List them with `dr-list-models`; * and ? stand for any characters, as in "
                '--models "team/*".',
            )
        found |= fitting
    return sorted(found)


def _metrics_prefix(settings: Settings, prefix: str) -> str:
    if prefix == settings.model_prefix:
        return settings.metrics_prefix
    return keys.metrics_prefix(prefix)


def _announced(tasks: Sequence[EvaluationTask], worlds: Sequence[str]) -> str:
    drivers = list(dict.fromkeys((task.prefix, task.checkpoint) for task in tasks))
    what = f"{len(drivers)} models"
    if len(drivers) == 1 or {prefix for prefix, _ in drivers} == {drivers[0][0]}:
        what = f"{' and '.join(name for _, name in drivers)} of {drivers[0][0]}"
    laps = tasks[0].fresh_laps
    how = " under a grid of disturbances" if tasks[0].robust else ""
    how += f", {laps} lap{'s' * (laps != 1)} from fresh starts" if laps else ""
    return f"Evaluating {what} on {', '.join(worlds)}{how} ..."


def _claimed(settings: Settings) -> tuple[str, Path]:
    at = time.time()
    while True:
        stamp = time.strftime("%Y%m%d%H%M%S", time.localtime(at))
        folder = claim(settings.directory, settings.run_id, stamp)
        if folder is not None:
            return stamp, folder
        at += 1.0


def _free_stamp(bucket: Bucket, prefix: str, stamp: str, index: int) -> str:
    at = time.mktime(time.strptime(stamp, "%Y%m%d%H%M%S")) + index
    while True:
        found = time.strftime("%Y%m%d%H%M%S", time.localtime(at))
        if not bucket.exists(keys.evaluation_trace(prefix, found)):
            return found
        at += 60.0
