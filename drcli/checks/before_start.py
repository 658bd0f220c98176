"""Checks before a training starts every rule that can keep it from starting."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event

from drcli.base.problems import Problem
from drcli.checks.compatibility_rules import review_import
from drcli.checks.machine_rules import review_disk
from drcli.checks.parameter_rules import ParametersReview, review_parameters
from drcli.checks.settings_rules import upload_problems
from drcli.checks.stage_rules import StagesReview
from drcli.checks.storage_rules import review_prefix, review_pretrained
from drcli.config.settings import Settings
from drcli.exchange.job import Job
from drcli.modelfiles.custom_files import InputFile, Inputs, missing_files
from drcli.modelfiles.network_shape import Design, weight_problems
from drcli.models.pretrained import Transfer
from drcli.rewards.reward_rules import Source, read_source
from drcli.rewards.try_inputs import try_inputs
from drcli.store import keys
from drcli.store.bucket import Bucket


@dataclass(frozen=True)
class Plans:
    """What is going to be started.

    Attributes:
        wiping: Whether the model under the prefix is deleted first.
        resumed: Design of that model, if the training continues it.
    """

    wiping: bool = False
    resumed: Design | None = None


@dataclass(frozen=True)
class Examined:
    """The problems, and what was read to find them.

    Attributes:
        files: The racer's files, by name.
        source: The reward function, if it compiles.
        review: The two parameter files.
        transfer: The weights to start from, if the settings name some that fit.
        problems: Everything that is wrong or odd.
    """

    files: Mapping[str, InputFile]
    source: Source | None
    review: ParametersReview
    transfer: Transfer | None
    problems: list[Problem]

    @property
    def inputs(self) -> Inputs:
        """All three files; only where nothing is wrong."""
        return Inputs(
            self.files[keys.REWARD_FUNCTION_FILE],
            self.files[keys.HYPERPARAMETERS_FILE],
            self.files[keys.MODEL_METADATA_FILE],
        )

    @property
    def design(self) -> Design:
        """Both parameter files; only where nothing is wrong."""
        if self.review.design is None:
            raise ValueError("the parameter files are wrong, so they have no design")
        return self.review.design


def examine(
    settings: Settings,
    job: Job,
    files: Mapping[str, InputFile],
    bucket: Bucket | None,
    plans: Plans = Plans(),
) -> Examined:
    """Check every rule about the racer's files, the bucket (if it can be used) and the disk.

    The reward function is called in a separate process. All other rules are checked while that one
    starts, so they cost no time.
    """
    reward = files.get(keys.REWARD_FUNCTION_FILE)
    source, found = (None, []) if reward is None else read_source(reward)
    given_up = Event()
    with ThreadPoolExecutor(1) as pool:
        try:
            trying = pool.submit(try_inputs, job.config, job.directory, source, given_up)
            review = review_parameters(
                files.get(keys.HYPERPARAMETERS_FILE), files.get(keys.MODEL_METADATA_FILE), settings
            )
            found += review.problems
            if review.design is not None:
                found += review_import(settings, review.design)
            transfer = None
            if bucket is not None:
                found += missing_files(files, settings.custom_files, bucket.name)
                transfer, wrong = _of_bucket(settings, bucket, review.design, plans)
                found += wrong
            found += upload_problems(settings)
            found += review_disk(settings.storage, job.directory)
            found += trying.result()
        finally:
            given_up.set()  # otherwise Ctrl-C, or a bucket that fails, would wait for the sandbox
    return Examined(files, source, review, transfer, found)


def examine_stages(
    settings: Settings,
    review: StagesReview,
    job: Job,
    files: Mapping[str, InputFile],
    bucket: Bucket | None,
    plans: Plans,
    *,
    first: int = 0,
) -> Examined:
    """Check every rule for each stage that is still to come; without stages, for the training.

    The result has the files and the design of the whole training. `first` is the place of the stage
    that trains first, from 0.
    """
    if review.frozen is None:
        return examine(settings, job, files, bucket, plans)
    coming = review.stages[first:]
    examined = [
        examine(
            stage.settings,
            replace(job, config=stage.settings.run),
            stage.files,
            bucket if number == 0 else None,
            plans,
        )
        for number, stage in enumerate(coming)
    ]
    whole = {**coming[0].files, **files}
    parameters = review_parameters(
        whole.get(keys.HYPERPARAMETERS_FILE), whole.get(keys.MODEL_METADATA_FILE), None
    )
    # It becomes that of the model, even if each stage has its own.
    reward = whole.get(keys.REWARD_FUNCTION_FILE)
    wrong = [] if reward is None else read_source(reward)[1]
    of_stages = (problem for each in examined for problem in each.problems)
    found = [*review.problems, *parameters.problems, *wrong, *of_stages]
    return replace(examined[0], files=whole, review=parameters, problems=list(dict.fromkeys(found)))


def _of_bucket(
    settings: Settings, bucket: Bucket, design: Design | None, plans: Plans
) -> tuple[Transfer | None, list[Problem]]:
    if plans.resumed is not None:
        model = f"s3://{bucket.name}/{settings.model_prefix}"
        return None, [] if design is None else weight_problems(plans.resumed, design, model)
    found = [] if plans.wiping else review_prefix(settings.model_prefix, bucket)
    if settings.pretrained_model is None:
        return None, found
    transfer, problems = review_pretrained(
        settings.pretrained_model, bucket, settings.model_prefix, design, wiping=plans.wiping
    )
    return transfer, found + problems
