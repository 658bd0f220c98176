"""hyperparameters.json: how a model is trained."""

import json
import re
from collections.abc import Container, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drcli.base.errors import (
    Problem,
    ProblemsError,
    SettingsError,
    Severity,
    closest,
    one_of,
    refuse,
    shown,
)
from drcli.bucket.bucket import ObjectMissing
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
from drcli.model.model_store import ModelStore

Exploration = Literal["categorical", "e-greedy", "additive_noise"]
Loss = Literal["huber", "mean squared error"]
Schedule = Literal["constant", "linear"]
Critic = Literal["camera", "state"]
TrainingMethod = Literal["camera", "teacher"]

_OTHER_LOSSES = dict.fromkeys(("mean_squared_error", "mse"), "mean squared error")
_LOSSES = (*get_args(Loss), *_OTHER_LOSSES)
_Exploration = Annotated[Exploration, choice(Exploration, {"e_greedy": "e-greedy"})]
_Loss = Annotated[Loss, choice(Loss, _OTHER_LOSSES)]
_Schedule = Annotated[Schedule, choice(Schedule)]

USUAL_SCORE, HIGH_SCORE = 350.0, 10_000.0
"""`term_cond_avg_score` of the reference's example, and one from which nobody expects an end."""

CONSOLE_LR = 1e-3
CONSOLE_EPISODES = 100
"""At most, for `lr` and `num_episodes_between_training`. Source: the console's limits."""

LEAST_DISCOUNT = 0.5
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

SYNONYMS = {
    "lr": ("learning_rate", "learningrate", "initial_lr", "step_size"),
    "beta_entropy": (
        *("entropy", "entropy_beta", "beta", "ent_coef", "entropy_coef", "entropy_coeff"),
        *("entropy_coefficient", "entropy_weight", "entropy_bonus", "entropy_regularization"),
    ),
    "clip_range": (
        *("clip", "cliprange", "clip_epsilon", "clip_eps", "clip_param", "clip_ratio", "epsilon"),
        *("clipping", "clipping_epsilon", "ppo_clip", "ppo_epsilon", "eps_clip"),
    ),
    "discount_factor": ("gamma", "discount", "discount_rate", "discounting"),
    "gae_lambda": ("lambda", "lam", "gae"),
    "batch_size": ("minibatch", "minibatch_size", "mini_batch_size", "batch"),
    "num_epochs": ("epochs", "epoch", "n_epochs", "number_of_epochs"),
    "num_episodes_between_training": (
        *("episodes", "num_episodes", "episodes_per_iteration", "experience_episodes"),
        *("number_of_experience_episodes", "episodes_between_training"),
    ),
    "loss_type": ("loss", "loss_function"),
    "exploration_type": ("exploration",),
    "e_greedy_value": ("e_greedy", "epsilon_greedy"),
    "term_cond_max_episodes": ("max_episodes", "max_iterations"),
    "max_grad_norm": ("grad_clip", "gradient_clip", "clip_norm", "max_norm"),
    "target_kl": ("kl_target", "kl"),
    "stack_size": ("frame_stack", "num_frames"),
}
"""Names in other programs and papers."""

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


@dataclass(frozen=True)
class Text:
    """What a hyperparameter does; `advice`: where to begin."""

    meaning: str
    higher: str = ""
    lower: str = ""
    advice: str = ""


class Hyperparameters(BaseModel):
    """Defaults are those of the reference trainer."""

    model_config = ConfigDict(frozen=True)

    batch_size: Annotated[
        Whole,
        Text(
            "Steps in a minibatch. The weights change once for each minibatch.",
            "Stabler: each change is a mean over more steps. Slower: there are fewer changes in an "
            "iteration.",
            "Faster at first, but noisier.",
            "Begin with 64. If the reward zigzags, try 128 before you lower lr.",
        ),
    ] = Field(64, ge=1)
    lr: Annotated[
        Number,
        Text(
            "Learning rate: how far each change of the weights goes.",
            "Converges faster, but the reward may zigzag or collapse. The console takes 0.001 at "
            "most.",
            "Stabler, but slow; much too low, the car never gets anywhere.",
            "The shipped 0.001 reaches the first lap soonest. Divide it by three when the reward "
            "zigzags or falls, or let it fall by itself with lr_schedule.",
        ),
    ] = Field(0.0003, ge=1e-8, le=1)
    discount_factor: Annotated[
        Number,
        Text(
            "Weight of a reward that comes one step later. With a factor g, the car plans about "
            "1 / (1 - g) steps ahead; 15 steps are one second.",
            "Plans further ahead, which rewards at the finish need. Learning gets harder, "
            "because more future steps add their chance to each estimate.",
            "Learns faster and more stably, but does not see what comes later. Much too low, the "
            "car takes a good moment now for a crash in two seconds.",
            "The shipped 0.95 plans 20 steps (1.3 s) ahead, enough for rewards at each step. "
            "Take 0.99 or 0.999 for rewards that come late.",
        ),
    ] = Field(0.999, ge=0, le=1)
    num_epochs: Annotated[
        Whole,
        Text(
            "Passes over the steps of an iteration.",
            "Learns more from the same steps, but takes more computing and may overfit to them: "
            "watch the KL divergence in the log.",
            "Stabler and cheaper, but learns less from each step.",
            "3. Try 10 if driving is the slow part, not learning.",
        ),
    ] = Field(10, ge=1)
    beta_entropy: Annotated[
        Number,
        Text(
            "Bonus for varied actions (entropy).",
            "Explores longer and escapes bad habits, but the car stays restless and converges "
            "later. Much too high, it drives at random.",
            "Converges earlier, but may settle on a habit that is only fairly good. With 0, it "
            "often settles too early.",
            "Begin with 0.01. Lower it to 0.001 when laps are complete and you want them fast.",
        ),
    ] = Field(0.01, ge=0, le=1)
    loss_type: Annotated[
        _Loss,
        Text(
            "The critic's loss, in the critic's own units.",
            "huber gives less weight to large errors: stabler, for example with a large bonus at "
            "the finish. 'mean squared error' follows large errors at once: faster when rewards "
            "are even, less stable when they are not.",
            "",
            "huber.",
        ),
    ] = "mean squared error"
    exploration_type: Annotated[
        _Exploration,
        Text(
            "How the car chooses actions while it trains.",
            "categorical draws each action from the policy's probabilities. e-greedy (discrete "
            "actions) "
            "takes a random action with a share that falls, otherwise the most likely one. "
            "additive_noise belongs to SAC.",
            "",
            "categorical for clipped_ppo, additive_noise for sac.",
        ),
    ] = "categorical"
    e_greedy_value: Annotated[
        Number,
        Text(
            "Only for exploration_type e-greedy: the share of random actions in the end.",
            "Explores more for ever; training episodes end earlier.",
            "Drives almost as in an evaluation, and learns little that is new.",
            "0.05, and only if you chose e-greedy.",
        ),
    ] = Field(0.05, ge=0, le=1)
    epsilon_steps: Annotated[
        Whole,
        Text(
            "Only for exploration_type e-greedy: the number of steps in which the share of random "
            "actions falls from 1 to e_greedy_value.",
            "Explores for longer before the car drives as it has learned.",
            "Trusts the policy earlier, perhaps before it has seen the whole track.",
            "10000.",
        ),
    ] = Field(10_000, ge=1)
    num_episodes_between_training: Annotated[
        Whole,
        Text(
            "Episodes in an iteration, of all workers together. The policy is updated after them.",
            "Stabler: each update knows more of the track. Slower: there are fewer updates.",
            "Reacts fast, and zigzags. Below 5, an update sees too little of the track.",
            "20; 40 with several workers, or when the curve zigzags.",
        ),
    ] = Field(20, ge=1, le=10_000)
    stack_size: Annotated[
        Whole,
        Text(
            "Frames that the network sees at once. The reference ignores this key.",
            "Shows motion, of bots for example. Each step computes more, and the physical car "
            "does not support it: a model with more than one frame cannot be exported for the "
            "car.",
            "1 is enough for a road without other cars.",
            "1.",
        ),
    ] = Field(1, ge=1)
    term_cond_max_episodes: Annotated[
        Whole,
        Text(
            "Iterations after which the training ends. Despite its name it counts iterations, not "
            "episodes, as in the reference.",
            advice="Leave it at 100000, and use DR_TRAIN_MAX_MINUTES or --until-laps.",
        ),
    ] = Field(100_000, ge=1)
    term_cond_avg_score: Annotated[
        Number,
        Text(
            "Mean score at which a training should end. The reference ignores it, and so does "
            "drcli.",
            advice="Use DR_TRAIN_STOP_MEAN_SCORE.",
        ),
    ] = 100_000.0
    sac_alpha: Annotated[
        Number,
        Text(
            "Only for sac: the temperature, which says how much reward one nat of entropy is "
            "worth. With sac_auto_alpha it is the first value, in the critics' own units.",
            "Explores longer, and converges later.",
            "Settles earlier, perhaps too early.",
            "Set sac_auto_alpha and write 0.1; the training adapts it.",
        ),
    ] = Field(0.2, ge=0, le=1)

    # Beyond the reference. Left out of the file, each is as in the reference, or off.
    clip_range: Annotated[
        Number,
        Text(
            "How far one iteration may change the probability of an action before it gains nothing "
            "more by it (PPO's epsilon).",
            "Larger updates: faster, less stable.",
            "Smaller, safer updates: stabler, slower.",
            "0.2.",
        ),
    ] = Field(0.2, ge=0.01, le=1)
    gae_lambda: Annotated[
        Number,
        Text(
            "How much an advantage trusts the rewards that followed, and how much the critic.",
            "Trusts the rewards: right on average, but noisy. 1 trusts only them.",
            "Trusts the critic: smooth, but wrong as long as the critic is. 0 trusts only the "
            "critic.",
            "0.95.",
        ),
    ] = Field(0.95, ge=0, le=1)
    clip_value: Annotated[
        Annotated[Number, Field(ge=0.001)] | None,
        Text(
            "How far a value prediction may move in an iteration before its loss is clipped; 5 "
            "is the mean size of the returns. Off if left out.",
            "The critic learns faster.",
            "The critic moves more steadily.",
            "Leave it out.",
        ),
    ] = None
    clip_advantage: Annotated[
        Annotated[Number, Field(ge=0.1)] | None,
        Text(
            "Largest advantage after it was normalised, so that one lucky step does not count for "
            "more. Off if left out.",
            "Lucky steps count for more.",
            "Stabler, but rare successes count for less.",
            "Leave it out; try 3 if one event throws the training off.",
        ),
    ] = None
    target_kl: Annotated[
        Annotated[Number, Field(ge=1e-6)] | None,
        Text(
            "An update ends early, after the first epoch in which the policy has changed by more "
            "than this (KL divergence). Off if left out.",
            "Larger updates: faster, less stable.",
            "Smaller updates: stabler, slower.",
            "0.02 is common when num_epochs is high.",
        ),
    ] = None
    max_grad_norm: Annotated[
        Annotated[Number, Field(ge=1e-6)] | None,
        Text(
            "Largest norm of a gradient. Off if left out.",
            "Large errors change more at once.",
            "Stabler: helps against a late collapse and against NaN.",
            "0.5 is common.",
        ),
    ] = None
    lr_schedule: Annotated[
        _Schedule,
        Text(
            "Whether lr stays (constant) or falls to a twentieth over schedule_steps (linear).",
            "linear converges fast at first and stably later.",
            "",
            "linear for long trainings; set schedule_steps to the steps that you plan.",
        ),
    ] = "constant"
    entropy_schedule: Annotated[
        _Schedule,
        Text(
            "Whether beta_entropy stays (constant) or falls to a twentieth over schedule_steps "
            "(linear).",
            "linear explores first and drives precisely later.",
            "",
            "linear for long trainings.",
        ),
    ] = "constant"
    schedule_steps: Annotated[
        Whole,
        Text(
            "Length of both schedules, in environment steps.",
            "The values fall more slowly.",
            "The values fall sooner; afterwards the model hardly changes any more.",
            "About as many steps as the training will take.",
        ),
    ] = Field(500_000, ge=1)
    critic: Annotated[
        Annotated[Critic, choice(Critic)],
        Text(
            "What the critic sees: the camera picture (camera), or offset, speed, the road ahead "
            "and objects (state). The policy never sees the state.",
            "state gives better estimates, but then only the policy's gradient trains the layers "
            "that read the camera.",
            "",
            "camera for PPO.",
        ),
    ] = "camera"
    training_method: Annotated[
        Annotated[TrainingMethod, choice(TrainingMethod)],
        Text(
            "How a training begins: with the camera alone (camera), or with a teacher that sees "
            "the track (teacher). The teacher learns to drive first, then a student with a "
            "camera learns from it, then PPO goes on. Only for clipped_ppo; `dr docs "
            "teacher` tells more.",
            "teacher learns fast laps much sooner. The learning curve is another one than the "
            "console's: "
            "the camera policy has learned nothing until its phase begins.",
            "",
            "camera if you want to compare with the console, or study PPO; teacher if you want a "
            "fast model soon.",
        ),
    ] = "camera"
    bootstrap_cut: Annotated[
        bool,
        Text(
            "Whether the critic's estimate is added to the return of an episode that the step "
            "limit cut off.",
            "true does not punish a car for a lap that takes too long.",
            "",
            "false.",
        ),
    ] = Field(False, strict=True)
    sac_auto_alpha: Annotated[
        bool,
        Text(
            "Only for sac: learns the temperature sac_alpha while it trains.",
            "true needs no search for the right sac_alpha.",
            "",
            "true.",
        ),
    ] = Field(False, strict=True)
    sac_tau: Annotated[
        Annotated[Number, Field(ge=1e-5, le=1)] | None,
        Text(
            "Only for sac: how fast the target critics follow the critics.",
            "Faster, less stable.",
            "Stabler, slower.",
            "0.02.",
        ),
    ] = None
    sac_n_step: Annotated[
        Annotated[Whole, Field(ge=1, le=100)] | None,
        Text(
            "Only for sac: rewards that a critic's target counts before it trusts a critic.",
            "Rewards travel back faster along the lap, but depend on older policies.",
            "1 is as in the reference: exact, but slow.",
            "5.",
        ),
    ] = None
    sac_updates_per_step: Annotated[
        Annotated[Number, Field(ge=0.001, le=16)] | None,
        Text(
            "Only for sac: gradient steps for each step driven.",
            "Learns more from each step, but takes more computing and is less stable.",
            "Cheaper, slower.",
            "0.5 on a processor, 1 on a GPU.",
        ),
    ] = None
    sac_replay_steps: Annotated[
        Whole,
        Text(
            "Only for sac: steps that the replay buffer holds; each frame takes 19.2 kB of memory.",
            "Stabler: it does not forget how bad driving looked.",
            "Less memory; follows the present policy more closely.",
            "100000.",
        ),
    ] = Field(100_000, ge=1_000)
    sac_learning_starts: Annotated[
        Whole,
        Text(
            "Only for sac: steps driven at random before the first gradient step.",
            "The critics begin with more variety.",
            "Learning starts sooner, from less.",
            "1000.",
        ),
    ] = Field(1_000, ge=1)

    problems: tuple[Problem, ...] = Field(default=(), exclude=True)

    @staticmethod
    def from_bytes(
        data: bytes, name: str = "hyperparameters.json", *, chosen: Container[str] = ()
    ) -> "Hyperparameters":
        """Read a file; unknown keys are warnings, as the reference ignores them.

        Those that were `chosen` by an option or a file of ours are errors.

        Raises:
            ProblemsError: A value is wrong, or a chosen key unknown.
        """
        return _read(read_json_object(data, name, "V-04"), chosen)

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

TEXTS: Mapping[str, Text] = {
    key: text
    for key in KEYS
    for text in Hyperparameters.model_fields[key].metadata
    if isinstance(text, Text)
}

EXAMPLES = Hyperparameters.model_validate({}).model_dump(exclude_none=True)


def _read(file: JsonFile, chosen: Container[str]) -> Hyperparameters:
    known = {key: written for key, written in file.values.items() if key in KEYS}
    problems = [
        _unknown(file, key, written, "error" if key in chosen else "warning")
        for key, written in file.values.items()
        if key not in KEYS
    ]
    loss = known.get("loss_type")
    if isinstance(loss, str) and loss.strip().casefold() not in _LOSSES:
        known["loss_type"] = "mean squared error"
        what = f"loss_type={as_written(loss)} is read as mean squared error, as in the reference."
        remedy = one_of(("huber", "mean squared error"), loss)
        problems.append(file.problem("V-43", ("loss_type",), what, remedy, "warning"))
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


def _unknown(file: JsonFile, key: str, written: Any, severity: Severity) -> Problem:
    if key in PASSED_THROUGH:
        what = f"{key} is for the reference's trainer and does nothing here."
        return file.problem("V-04", (key,), what, "Keep or remove the line.", "warning")
    folded = re.sub(r"[\s-]+", "_", key.strip().casefold())
    meant = next((name for name, others in SYNONYMS.items() if folded in others), None)
    meant = meant or closest(folded, KEYS, cutoff=0.8)
    remedy = f"Remove the line; the keys are {', '.join(KEYS)}."
    if meant is not None:
        remedy = f"Did you mean {meant}? Correct the key, or remove the line."
    what = f"{shown(key)}={as_written(written)} is not a hyperparameter and has no effect."
    return file.problem("V-04", (key,), what, remedy, severity)


def _unusual(v: Hyperparameters) -> Iterator[tuple[str, str, str]]:
    if v.batch_size == 34:
        yield "batch_size", "is used as it is; 32 is probably meant", "Write 32."
    elif v.batch_size not in (32, 64, 128, 256, 512):
        remedy = "Write 64 if you have no reason for another."
        yield "batch_size", "is unusual; common are 32, 64, 128, 256, 512", remedy
    if not 3 <= v.num_epochs <= 10:
        remedy = "Write 3 to 10 if you have no reason for another."
        yield "num_epochs", "is unusual; common are 3 to 10", remedy
    if v.lr > CONSOLE_LR:
        yield "lr", f"is above {CONSOLE_LR:g}, the most that the console takes", "Write 0.001."
    if v.num_episodes_between_training > CONSOLE_EPISODES:
        yield (
            "num_episodes_between_training",
            f"is above {CONSOLE_EPISODES}, the most that the console takes",
            "Write 100 or less if you want to train the model there.",
        )
    if v.num_episodes_between_training < 5:
        yield (
            "num_episodes_between_training",
            "gives the trainer little to learn from; 10, 20 or 40 are usual",
            "Write 20.",
        )
    if v.term_cond_avg_score != USUAL_SCORE and v.term_cond_avg_score < HIGH_SCORE:
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
    if v.discount_factor < LEAST_DISCOUNT:
        what = "plans less than two steps (0.13 s) ahead: what comes later counts for nothing"
        yield "discount_factor", what, "Write 0.9 to 0.999."
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
    files: Mapping[str, InputFile], method: TrainingMethod | None, *, taught: bool
) -> dict[str, InputFile]:
    """An option's `method`, else the file's, else the teacher of a `taught` model."""
    file = files.get(keys.HYPERPARAMETERS_FILE)
    wanted = method or ("teacher" if taught else None)
    if file is None or wanted is None or (method is None and _WRITTEN.search(_text(file))):
        return dict(files)
    return {**files, file.name: replace(file, data=with_method(file.data, wanted))}


def is_taught(model: ModelStore) -> bool:
    """Whether a model has a teacher."""
    with suppress(ObjectMissing, ProblemsError):
        data = model.bucket.get(keys.hyperparameters(model.prefix))
        return Hyperparameters.from_bytes(data).taught
    return False


def _text(file: InputFile) -> str:
    return file.data.decode("utf-8-sig", "replace")
