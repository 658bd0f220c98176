"""hyperparameters.json: how a model is trained."""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drcli.base.errors import Problem, ProblemsError, SettingsError, closest, refuse, shown
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.config.new_folder import FolderPlan
from drcli.learn.algorithms import ALGORITHMS, Algorithm, algorithm_named
from drcli.model import keys
from drcli.model.files.custom_files import InputFile
from drcli.model.files.data_file import (
    JsonFile,
    KeyPath,
    Number,
    Whole,
    as_written,
    choice,
    problems_of,
    read_json_object,
)
from drcli.model.files.model_metadata import ModelMetadata

Exploration = Literal["categorical", "e-greedy", "additive_noise"]
Loss = Literal["huber", "mean squared error"]
Schedule = Literal["constant", "linear"]
Critic = Literal["camera", "state"]
TrainingMethod = Literal["camera", "teacher"]

_Exploration = Annotated[Exploration, choice(Exploration, {"e_greedy": "e-greedy"})]
_Loss = Annotated[
    Loss, choice(Loss, dict.fromkeys(("mean_squared_error", "mse"), "mean squared error"))
]
_Schedule = Annotated[Schedule, choice(Schedule)]

USUAL_SCORES = (350.0, 100_000.0)
"""Of `term_cond_avg_score` in example files: nobody expects an effect."""

FEW_ITERATIONS = 100
"""A lower `term_cond_max_episodes` probably means episodes."""

PASSED_THROUGH = (
    "preset_s3_key",
    "max_sample_count",
    "sampling_frequency",
    "s3_kms_cmk_arn",
    "is_profiler_on",
    "profiler_s3_bucket",
    "profiler_s3_prefix",
)
"""Only for the reference's trainer process."""

RULES = {
    "batch_size": "V-40",
    "num_epochs": "V-41",
    "lr": "V-41",
    "beta_entropy": "V-41",
    "discount_factor": "V-41",
    "num_episodes_between_training": "V-41",
    "loss_type": "V-43",
    "term_cond_avg_score": "V-44",
    "term_cond_max_episodes": "V-44",
    "exploration_type": "V-34",
}
"""V-46 is about all others, V-04 about unknown keys."""


class Hyperparameters(BaseModel):
    """Defaults are those of the reference trainer."""

    model_config = ConfigDict(frozen=True)

    batch_size: Whole = Field(64, ge=1)
    lr: Number = Field(0.0003, ge=1e-8, le=1e-3)
    discount_factor: Number = Field(0.999, ge=0, le=1)
    num_epochs: Whole = Field(10, ge=1)
    beta_entropy: Number = Field(0.01, ge=0, le=1)
    loss_type: _Loss = "mean squared error"
    exploration_type: _Exploration = "categorical"
    e_greedy_value: Number = Field(0.05, ge=0, le=1)
    epsilon_steps: Whole = Field(10_000, ge=1)
    num_episodes_between_training: Whole = Field(20, ge=1, le=100)
    stack_size: Whole = Field(1, ge=1)
    term_cond_max_episodes: Whole = Field(100_000, ge=1)
    term_cond_avg_score: Number = 100_000.0
    sac_alpha: Number = Field(0.2, ge=0, le=1)

    # Beyond the reference. Left out of the file, each is as in the reference, or off.
    clip_range: Number = Field(0.2, ge=0.01, le=1)
    gae_lambda: Number = Field(0.95, ge=0, le=1)
    clip_value: Annotated[Number, Field(ge=0.001)] | None = None
    clip_advantage: Annotated[Number, Field(ge=0.1)] | None = None
    target_kl: Annotated[Number, Field(ge=1e-6)] | None = None
    max_grad_norm: Annotated[Number, Field(ge=1e-6)] | None = None
    lr_schedule: _Schedule = "constant"
    entropy_schedule: _Schedule = "constant"
    schedule_steps: Whole = Field(500_000, ge=1)
    critic: Annotated[Critic, choice(Critic)] = "camera"
    training_method: Annotated[TrainingMethod, choice(TrainingMethod)] = "camera"
    bootstrap_cut: bool = Field(False, strict=True)
    sac_auto_alpha: bool = Field(False, strict=True)
    sac_tau: Annotated[Number, Field(ge=1e-5, le=1)] | None = None
    sac_n_step: Annotated[Whole, Field(ge=1, le=100)] | None = None
    sac_updates_per_step: Annotated[Number, Field(ge=0.001, le=16)] | None = None
    sac_replay_steps: Whole = Field(100_000, ge=1_000)
    sac_learning_starts: Whole = Field(1_000, ge=1)

    problems: tuple[Problem, ...] = Field(default=(), exclude=True)

    @staticmethod
    def from_bytes(data: bytes, name: str = "hyperparameters.json") -> "Hyperparameters":
        """Raises ProblemsError for an unknown key or a wrong value."""
        return _read(read_json_object(data, name, "V-04"))

    @property
    def huber(self) -> bool:
        return self.loss_type == "huber"

    @property
    def taught(self) -> bool:
        return self.training_method == "teacher"

    def canonical_json(self, training_algorithm: str = "clipped_ppo") -> str:
        """The copy that is stored with a model.

        Has the algorithm's keys (13 of clipped_ppo, 12 of sac), and ours with an effect.
        """
        dropped = algorithm_named(training_algorithm).drops
        ours = self.model_dump(include=set(OWN_KEYS), exclude_defaults=True)
        values = self.model_dump(include=set(REFERENCE_KEYS) - dropped) | ours
        return json.dumps(values, indent=2, sort_keys=True)

    def conflict(self, algorithm: Algorithm, *, continuous: bool) -> str | None:
        """Why it does not fit a model, or None."""
        if self.taught and not algorithm.teachable:
            return (
                "training_method=teacher goes on with clipped_ppo, but model_metadata.json has "
                f"training_algorithm={algorithm.name}."
            )
        refused = {**algorithm.refuses, **(algorithm.refuses_with_ranges if continuous else {})}
        reason = refused.get(self.exploration_type)
        return None if reason is None else f"exploration_type={self.exploration_type} {reason}."


KEYS = tuple(name for name in Hyperparameters.model_fields if name != "problems")
REFERENCE_KEYS = KEYS[: KEYS.index("clip_range")]
OWN_KEYS = KEYS[KEYS.index("clip_range") :]
"""Those that the reference does not know."""

EXAMPLES = Hyperparameters.model_validate({}).model_dump(exclude_none=True)


def _read(file: JsonFile) -> Hyperparameters:
    known = {key: written for key, written in file.values.items() if key in KEYS}
    problems = [
        _unknown(file, key, written) for key, written in file.values.items() if key not in KEYS
    ]
    try:
        read = Hyperparameters.model_validate(known)
    except ValidationError as error:
        refuse([*problems, *problems_of(error, file, _rule_of, EXAMPLES)])
        raise
    refuse(problems)
    problems += [
        file.problem(_rule_of((key,)), (key,), f"{key}={known[key]:g} {reason}.", remedy, "warning")
        for key, reason, remedy in _unusual(read)
        if key in known
    ]
    return read.model_copy(update={"problems": tuple(problems)})


def _rule_of(path: KeyPath) -> str:
    return RULES.get(str(path[0]), "V-46")


def _unknown(file: JsonFile, key: str, written: Any) -> Problem:
    if key in PASSED_THROUGH:
        what = f"{key} is for the reference's trainer and does nothing here."
        return file.problem("V-04", (key,), what, "Keep or remove the line.", "warning")
    meant = closest(key, KEYS)
    remedy = f"Did you mean {meant}? Correct the key" if meant is not None else "Remove the line"
    what = f"{shown(key)}={as_written(written)} is not a hyperparameter."
    return file.problem("V-04", (key,), what, f"{remedy}; the keys are {', '.join(KEYS)}.")


def _unusual(v: Hyperparameters) -> Iterator[tuple[str, str, str]]:
    if v.batch_size == 34:
        yield "batch_size", "is used as it is; 32 is probably meant", "Write 32."
    elif v.batch_size not in (32, 64, 128, 256, 512):
        remedy = "Write 64 if you have no reason for another."
        yield "batch_size", "is unusual; common are 32, 64, 128, 256, 512", remedy
    if not 3 <= v.num_epochs <= 10:
        remedy = "Write 3 to 10 if you have no reason for another."
        yield "num_epochs", "is unusual; common are 3 to 10", remedy
    if v.num_episodes_between_training < 5:
        yield (
            "num_episodes_between_training",
            "gives the trainer little to learn from; 10, 20 or 40 are usual",
            "Write 20.",
        )
    if v.term_cond_avg_score not in USUAL_SCORES:
        yield (
            "term_cond_avg_score",
            "has no effect, as in other trainers",
            "Set DR_TRAIN_STOP_MEAN_SCORE in run.env to end a training by its mean reward.",
        )
    if v.term_cond_max_episodes < FEW_ITERATIONS:
        yield (
            "term_cond_max_episodes",
            "ends the training after so many iterations; despite its name the key counts "
            "iterations, as in other trainers",
            "Write 1000 or more to train on.",
        )
    if v.stack_size > 1:
        yield (
            "stack_size",
            f"shows the network {v.stack_size} frames at a time; other trainers ignore this key, "
            "and the physical car drives with a single frame only",
            "Write 1 for a model that is to drive on other simulators.",
        )
    if v.discount_factor >= 1.0:
        yield ("discount_factor", "looks ahead without end; 0.999 is usual", "Write 0.999 or less.")


# Writes training_method into a hyperparameters.json.


_KEY = "training_method"
_WRITTEN = re.compile(rf'"{_KEY}"\s*:\s*("[^"\n]*"|[^,}}\s]+)')


def method_of(teacher: bool) -> TrainingMethod:
    return "teacher" if teacher else "camera"


def with_method(data: bytes, method: TrainingMethod, *, own_line: bool = False) -> bytes:
    """The file with that method, unless it is not an object.

    All else stays in its line, which messages name.
    """
    text = data.decode("utf-8-sig", "surrogateescape")
    written = f'"{_KEY}": "{method}"'
    changed, count = _WRITTEN.subn(written, text, 1)
    if not count:
        before, brace, after = text.partition("{")
        if not brace:
            return data
        comma = "" if after.lstrip().startswith("}") else ","
        gap = "\n  " if own_line else ""
        changed = f"{before}{{{gap}{written}{comma}{'' if own_line else ' '}{after}"
    return changed.encode("utf-8", "surrogateescape")


def plan_with_method(plan: FolderPlan, teacher: bool) -> FolderPlan:
    """Raises SettingsError without hyperparameters.json, or if the algorithm takes no teacher."""
    at = {PurePosixPath(file.name).name: file for file in plan.files}
    file, metadata = at.get(keys.HYPERPARAMETERS_FILE), at.get(keys.MODEL_METADATA_FILE)
    if file is None:
        raise SettingsError(
            f"--teacher: there is no {keys.HYPERPARAMETERS_FILE} to write training_method into.",
            remedy="Start with `dr-start-training --teacher` instead.",
        )
    algorithm = ALGORITHMS["clipped_ppo"]
    if metadata is not None:
        with suppress(ProblemsError):
            algorithm = ModelMetadata.from_bytes(metadata.data).algorithm
    if teacher and metadata is not None and not algorithm.teachable:
        raise SettingsError(
            "--teacher: training_method=teacher goes on with clipped_ppo, but "
            f"{metadata.name} has training_algorithm={algorithm.name}.",
            remedy="Leave out --teacher, or choose another --preset.",
        )
    changed = replace(file, data=with_method(file.data, method_of(teacher), own_line=True))
    return replace(plan, files=tuple(changed if each is file else each for each in plan.files))


def chosen_method(
    files: Mapping[str, InputFile], method: TrainingMethod | None, kept: TrainingMethod | None
) -> dict[str, InputFile]:
    """An option's `method`, else the file's, else that `kept` by the model."""
    file = files.get(keys.HYPERPARAMETERS_FILE)
    wanted = method or kept
    if file is None or wanted is None or (method is None and _WRITTEN.search(_text(file))):
        return dict(files)
    return {**files, file.name: replace(file, data=with_method(file.data, wanted))}


def kept_method(bucket: Bucket, prefix: str | None) -> TrainingMethod | None:
    """A model's, if it has a teacher."""
    if prefix is None:
        return None
    with suppress(ObjectMissing, ProblemsError):
        parameters = Hyperparameters.from_bytes(bucket.get(keys.hyperparameters(prefix)))
        return "teacher" if parameters.taught else None
    return None


def _text(file: InputFile) -> str:
    return file.data.decode("utf-8-sig", "replace")
