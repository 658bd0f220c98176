"""hyperparameters.json: how the learner learns, checked key by key."""

import json
from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from drcli.base.problems import Finding, closest, one_of, settings_error, shown
from drcli.modelfiles.json_file import JsonFile, as_written, read_json_object

Exploration = Literal["categorical", "e-greedy", "additive_noise"]
Loss = Literal["huber", "mean squared error"]
Schedule = Literal["constant", "linear"]
Critic = Literal["camera", "state"]

USUAL_SCORES = (350.0, 100_000.0)
"""`term_cond_avg_score` in the files that everybody has: nobody expects anything of these."""

FEW_ITERATIONS = 100
"""A `term_cond_max_episodes` below this was probably meant in episodes."""

PASSED_THROUGH = (
    "preset_s3_key",
    "max_sample_count",
    "sampling_frequency",
    "s3_kms_cmk_arn",
    "is_profiler_on",
    "profiler_s3_bucket",
    "profiler_s3_prefix",
)
"""Keys that steer the reference's trainer process. They are kept and do nothing here."""


class Hyperparameters(BaseModel):
    """All hyperparameters; those missing in the file have the reference trainer's defaults."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    batch_size: int = Field(64, ge=1)
    lr: float = Field(0.0003, ge=1e-8, le=1e-3)
    discount_factor: float = Field(0.999, ge=0, le=1)
    num_epochs: int = Field(10, ge=1)
    beta_entropy: float = Field(0.01, ge=0, le=1)
    loss_type: Loss = "mean squared error"
    exploration_type: Exploration = "categorical"
    e_greedy_value: float = Field(0.05, ge=0, le=1)
    epsilon_steps: int = Field(10_000, ge=1)
    num_episodes_between_training: int = Field(20, ge=1, le=100)
    stack_size: int = Field(1, ge=1)
    term_cond_max_episodes: int = Field(100_000, ge=1)
    term_cond_avg_score: float = 100_000.0
    sac_alpha: float = Field(0.2, ge=0, le=1)

    # Beyond the reference. Left out of the file, each is as in the reference, or off.
    clip_range: float = Field(0.2, ge=0.01, le=1)
    gae_lambda: float = Field(0.95, ge=0, le=1)
    clip_value: float | None = Field(None, ge=0.001)
    clip_advantage: float | None = Field(None, ge=0.1)
    target_kl: float | None = Field(None, ge=1e-6)
    max_grad_norm: float | None = Field(None, ge=1e-6)
    lr_schedule: Schedule = "constant"
    entropy_schedule: Schedule = "constant"
    schedule_steps: int = Field(500_000, ge=1)
    critic: Critic = "camera"
    bootstrap_cut: bool = False
    sac_auto_alpha: bool = False
    sac_tau: float | None = Field(None, ge=1e-5, le=1)
    sac_updates_per_step: float | None = Field(None, ge=0.001, le=16)
    sac_replay_steps: int = Field(100_000, ge=1_000)
    sac_learning_starts: int = Field(1_000, ge=1)

    extra: Mapping[str, Any] = Field(default={}, exclude=True)
    """Keys of the reference's trainer process, with their values."""
    notes: tuple[Finding, ...] = Field(default=(), exclude=True)
    """Values that are legal but unusual, each with what to do about it."""

    @staticmethod
    def from_bytes(data: bytes, name: str = "hyperparameters.json") -> "Hyperparameters":
        """Read a file's content.

        Args:
            data: The content.
            name: What to call the file in messages.

        Raises:
            SettingsError: A key is unknown, misspelt, of the wrong type or out of range.
        """
        return _check(read_json_object(data, name))

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notes as sentences."""
        return tuple(map(str, self.notes))

    @property
    def huber(self) -> bool:
        """Whether the value loss is Huber's; otherwise it is the mean squared error."""
        return self.loss_type == "huber"

    def canonical_json(self, training_algorithm: str = "clipped_ppo") -> str:
        """All values filled in, in the layout of the copy that lies beside a model.

        Two spaces of indent, sorted keys, and only the keys of the algorithm: 13 for clipped_ppo,
        12 for sac, and those beyond the reference that differ from its behaviour.
        """
        foreign = {"sac_alpha"}
        if training_algorithm == "sac":
            foreign = {"beta_entropy", "num_epochs"}
        ours = self.model_dump(include=set(OWN_KEYS), exclude_defaults=True)
        values = self.model_dump(include=set(REFERENCE_KEYS) - foreign) | ours
        return json.dumps(values, indent=2, sort_keys=True)

    def conflict(self, algorithm: str, *, continuous: bool) -> str | None:
        """Why this does not fit a model, as one sentence; None when it does.

        Args:
            algorithm: `training_algorithm` of model_metadata.json.
            continuous: Whether its actions are ranges.
        """
        if algorithm == "sac":
            if self.exploration_type == "e-greedy":
                return (
                    "exploration_type=e-greedy chooses from a list of actions; sac draws from "
                    "ranges, which is additive_noise."
                )
            return None
        if self.exploration_type == "additive_noise":
            return (
                "exploration_type=additive_noise belongs to sac; clipped_ppo explores with "
                "categorical."
            )
        if self.exploration_type == "e-greedy" and continuous:
            return (
                "exploration_type=e-greedy chooses from a list of actions; this model has ranges, "
                "which clipped_ppo explores with categorical."
            )
        return None


KEYS = tuple(name for name in Hyperparameters.model_fields if name not in ("extra", "notes"))
"""Every key of the file."""

REFERENCE_KEYS = KEYS[: KEYS.index("clip_range")]
OWN_KEYS = KEYS[KEYS.index("clip_range") :]
"""The keys that the reference knows too, and those beyond it."""

_SPELLINGS = {
    "loss_type": {"mean_squared_error": "mean squared error", "mse": "mean squared error"},
    "exploration_type": {"e_greedy": "e-greedy"},
}
"""Other spellings in use; letter case never matters."""


def _check(file: JsonFile) -> Hyperparameters:
    findings: list[Finding] = []
    notes: list[Finding] = []
    values: dict[str, Any] = {}
    extra: dict[str, Any] = {}
    for key, written in file.values.items():
        where = file.where(key)
        if key in PASSED_THROUGH:
            extra[key] = written
            what = f"{key} steers the reference's trainer and does nothing here"
            notes.append(Finding(where, what, "Keep or remove the line."))
        elif key not in KEYS:
            findings.append(_unknown(where, key, written))
        else:
            values[key], problem = _value(key, written)
            if problem is not None:
                what = f"{key}={as_written(written)} {problem[0]}"
                findings.append(Finding(where, what, problem[1]))
    if findings:
        raise settings_error(findings)
    unusual = Hyperparameters(**values)
    notes += [
        Finding(file.where(key), what, remedy)
        for key, what, remedy in _unusual(unusual)
        if key in values
    ]
    return Hyperparameters(**values, extra=extra, notes=tuple(notes))


def _unknown(where: str, key: str, written: Any) -> Finding:
    meant = closest(key, KEYS)
    remedy = f"Did you mean {meant}? Correct the key" if meant is not None else "Remove the line"
    what = f"{shown(key)}={as_written(written)} is no hyperparameter"
    return Finding(where, what, f"{remedy}; the keys are {', '.join(KEYS)}.")


def _value(key: str, written: Any) -> tuple[Any, tuple[str, str] | None]:
    """The value to use, or the reason and remedy why there is none."""
    info = Hyperparameters.model_fields[key]
    kinds = get_args(info.annotation) or (info.annotation,)
    if type(None) in kinds and written is None:
        return None, None
    if info.annotation is bool:
        if isinstance(written, bool):
            return written, None
        return None, ("is neither true nor false", f'Write "{key}": true, without quotes.')
    if isinstance(kinds[0], str):
        return _word(key, written, kinds)
    whole = kinds[0] is int
    low = next((rule.ge for rule in info.metadata if hasattr(rule, "ge")), None)
    high = next((rule.le for rule in info.metadata if hasattr(rule, "le")), None)
    expected = "a whole number" if whole else "a number"
    if low is not None:
        expected += f" from {low} to {high}" if high is not None else f", {low} or more"
    example = low if info.default is None else info.default
    remedy = f"Write {expected}, without quotes, as in {json.dumps(key)}: {example}."
    if isinstance(written, bool) or not isinstance(written, int | float):
        return None, ("is no number", remedy)
    if abs(written) > 1e15:
        return None, ("is far too large", remedy)
    if whole and written != int(written):
        return None, ("is no whole number", remedy)
    if low is not None and written < low:
        return None, (f"is below {low}", remedy)
    if high is not None and written > high:
        return None, (f"is above {high}", remedy)
    return (int(written) if whole else float(written)), None


def _word(
    key: str, written: Any, words: tuple[str, ...]
) -> tuple[str | None, tuple[str, str] | None]:
    if not isinstance(written, str):
        return None, ("is no text", f"Write one of {', '.join(words)} in double quotes.")
    word = written.strip().casefold()
    word = _SPELLINGS.get(key, {}).get(word, word)
    if word not in words:
        return None, (f"is none of {', '.join(words)}", one_of(words, written))
    return word, None


def _unusual(values: Hyperparameters) -> Iterator[tuple[str, str, str]]:
    """Keys outside what the DeepRacer console offers, what to know about each, and a remedy."""
    v = values
    if v.batch_size == 34:
        yield (
            "batch_size",
            "batch_size=34 is used as it is; 32 is probably meant",
            "Write 32.",
        )
    elif v.batch_size not in (32, 64, 128, 256, 512):
        yield (
            "batch_size",
            f"batch_size={v.batch_size} is unusual; common are 32, 64, 128, 256, 512",
            "Write 64 if you have no reason for another.",
        )
    if not 3 <= v.num_epochs <= 10:
        yield (
            "num_epochs",
            f"num_epochs={v.num_epochs} is unusual; common are 3 to 10",
            "Write 3 to 10 if you have no reason for another.",
        )
    if v.num_episodes_between_training < 5:
        yield (
            "num_episodes_between_training",
            f"num_episodes_between_training={v.num_episodes_between_training} leaves the learner "
            "little to learn from; 10, 20 or 40 are usual with clipped_ppo",
            "Write 20, unless the algorithm is sac.",
        )
    if v.term_cond_avg_score not in USUAL_SCORES:
        yield (
            "term_cond_avg_score",
            f"term_cond_avg_score={v.term_cond_avg_score:g} has no effect, as in other trainers",
            "Set DR_TRAIN_STOP_REWARD in run.env to end a training by its mean reward.",
        )
    if v.term_cond_max_episodes < FEW_ITERATIONS:
        yield (
            "term_cond_max_episodes",
            f"term_cond_max_episodes={v.term_cond_max_episodes} ends the training after so many "
            "iterations; despite its name the key counts these, as in other trainers",
            "Write 1000 or more to train on.",
        )
    if v.stack_size > 1:
        yield (
            "stack_size",
            f"stack_size={v.stack_size}: the network sees {v.stack_size} frames at a time; other "
            "trainers ignored this key, and the physical car drives with a single frame only",
            "Write 1 for a model that shall drive elsewhere.",
        )
    if v.discount_factor >= 1.0:
        yield (
            "discount_factor",
            "discount_factor=1 looks ahead without end; 0.999 is usual",
            "Write 0.999 or less.",
        )
