"""Checks every rule that can keep a training from starting."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event

from drcli.base.errors import Problem
from drcli.bucket.bucket import Bucket
from drcli.checks.compatibility_rules import review_import
from drcli.checks.machine_rules import review_disk
from drcli.checks.parameter_rules import ParametersReview, review_parameters
from drcli.checks.settings_rules import upload_problems
from drcli.checks.stage_rules import StagesReview
from drcli.checks.start_rules import review_prefix, review_pretrained
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.files.custom_files import InputFile, Inputs, missing_files
from drcli.model.files.network_shape import Design, weight_problems
from drcli.model.model_prefix import ModelListing
from drcli.rewards.reward_rules import Source, read_source
from drcli.rewards.try_inputs import try_inputs
from drcli.transfer.pretrained import Transfer


@dataclass(frozen=True)
class Plans:
    """`wiping` deletes the model first, `resumed` is continued; a new one finds `listed`."""

    wiping: bool = False
    resumed: Design | None = None
    listed: ModelListing | None = None


@dataclass(frozen=True)
class Examined:
    """The problems, and what was read to find them, as far as it is right."""

    files: Mapping[str, InputFile]
    source: Source | None
    review: ParametersReview
    transfer: Transfer | None
    problems: list[Problem]

    @property
    def inputs(self) -> Inputs:
        """Only where nothing is wrong."""
        return Inputs(
            self.files[keys.REWARD_FUNCTION_FILE],
            self.files[keys.HYPERPARAMETERS_FILE],
            self.files[keys.MODEL_METADATA_FILE],
        )

    @property
    def design(self) -> Design:
        """Only where nothing is wrong."""
        if self.review.design is None:
            raise ValueError("the parameter files are wrong, so they have no design")
        return self.review.design


def examine(
    settings: Settings,
    files: Mapping[str, InputFile],
    bucket: Bucket | None,
    plans: Plans = Plans(),
) -> Examined:
    """Check every rule about files, bucket and disk.

    The reward function is called in a process. All else is checked while that one starts.
    """
    reward = files.get(keys.REWARD_FUNCTION_FILE)
    source, found = (None, []) if reward is None else read_source(reward)
    given_up = Event()
    with ThreadPoolExecutor(1) as pool:
        try:
            metadata = files.get(keys.MODEL_METADATA_FILE)
            trying = pool.submit(
                try_inputs, settings.run, settings.directory, source, given_up, metadata
            )
            review = review_parameters(files.get(keys.HYPERPARAMETERS_FILE), metadata, settings)
            found += review.problems
            if review.design is not None:
                found += review_import(settings, review.design)
            transfer = None
            if bucket is not None:
                found += missing_files(files, settings.custom_files, bucket.name)
                transfer, wrong = _of_bucket(settings, bucket, review.design, plans)
                found += wrong
            found += upload_problems(settings)
            found += review_disk(settings.storage, settings.directory)
            found += trying.result()
        finally:
            given_up.set()  # otherwise Ctrl-C, or a bucket that fails, would wait for the sandbox
    return Examined(files, source, review, transfer, found)


def examine_stages(
    settings: Settings,
    review: StagesReview,
    files: Mapping[str, InputFile],
    bucket: Bucket | None,
    plans: Plans,
    *,
    first: int = 0,
) -> Examined:
    """Check every rule for each stage from `first` on; without stages, for the training."""
    if review.frozen is None:
        return examine(settings, files, bucket, plans)
    coming = review.stages[first:]
    examined = [
        examine(stage.settings, stage.files, bucket if number == 0 else None, plans)
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
    found = [] if plans.listed is None else review_prefix(plans.listed)
    if settings.pretrained_model is None:
        return None, found
    transfer, problems = review_pretrained(
        settings.pretrained_model, bucket, settings.model_prefix, design, wiping=plans.wiping
    )
    return transfer, found + problems
