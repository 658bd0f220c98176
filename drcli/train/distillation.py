"""Trains a network of the reference's to do what a model with another network does.

The model drives at first, and more and more the new network, which learns what the model would do
there: as a student learns from its teacher (`drcli.learn.taught`).
"""

import json
import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import torch
from safetensors.torch import save as save_tensors
from torch import Tensor

from drcli.base.errors import ProblemsError, SettingsError
from drcli.config.run_config import DriveConfig, TrainConfig
from drcli.config.track_names import training_races
from drcli.convert.build_network import (
    build_policy,
    load_arrays,
    load_weights,
    policy_spec,
    weights_of,
)
from drcli.convert.reference_checkpoint import refuse_other_networks
from drcli.convert.reference_layout import NETWORKS
from drcli.drive.build_race import actions_of, build_simulation, realism_of
from drcli.drive.driving import Driver, Plan, Racer, rollout_of
from drcli.drive.evaluator import MOST_CARS
from drcli.learn.actor_critic import FIRST_LOG_STD, ActorCritic
from drcli.learn.compute import choose_compute
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.encoders import Network
from drcli.learn.policy import Float32s, Observation, Policy
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.taught import SMALL_LOG_STD, STUDENT, Distillation
from drcli.model import keys
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.records.iteration import Laps
from drcli.records.stage import PhaseMark
from drcli.train.training_progress import (
    EPISODES,
    FOLLOWS,
    MIXED_ITERATIONS,
    PhaseJudge,
    teacher_drives,
)
from drcli.train.training_simulation import (
    MILD,
    HeldOutTracks,
    TrackChoice,
    plan_of_phase,
    rules_on,
    tracks_of,
)
from drcli.workers.cores import usable_cores
from drsim.episode.reward import centre_line_reward

NETWORK = NETWORKS[0]
LAPS = 40
LEAST_CLEAN = 0.7
"""Share of the laps; a network that completes fewer is not worth an export."""

_MARK = PhaseMark("distillation", 0, 0)
_LABELS_AT_A_TIME = 256
"""Steps, whose activations take 20 MB."""


@dataclass(frozen=True)
class Distilled:
    """The result: a model with a network of the reference's, and how both drive."""

    design: Design
    weights: bytes
    steps: int
    seconds: float
    original: Laps
    laps: Laps

    def __str__(self) -> str:
        return (
            f"{NETWORK} learned from the actions of this model, {self.steps:,} steps in "
            f"{self.seconds:.0f} s. From drawn starts it drives {self.laps}; the model itself "
            f"{self.original}."
        )


def distil(
    races: Sequence[DriveConfig],
    train: TrainConfig,
    design: Design,
    weights: bytes,
    name: str,
    *,
    seed: int,
    say: Callable[[str], None],
) -> Distilled:
    """Train until the new network laps as the model does on the tracks of its races.

    Args:
        races: Of each worker that trained the model; episodes begin anywhere, in all directions.
            All are driven with car and obstacles of the first.
        train: How many cores it may take.
        design: Of the model.
        weights: Safetensors of the model.
        name: Of the checkpoint.
        seed: Decides everything random.
        say: Called with a sentence about each step forward.

    Raises:
        SettingsError: One of the two completes too few laps, or the weights do not fit.
        ProblemsError: A track is not installed, or has no room for the race.
    """
    began = time.monotonic()
    if races[0].untrainable is not None:
        raise ProblemsError([races[0].untrainable])
    original = Teaching(design, weights, name)
    wanted = student_design(design)
    torch.manual_seed(seed)
    threads = usable_cores(train)
    compute = choose_compute(train.torch_precision, STUDENT.batch_size, threads)
    student = ActorCritic(policy_spec(wanted.metadata, wanted.parameters))
    driving = ActorCritic(student.spec).eval()
    if student.spec.continuous:
        with torch.no_grad():
            student.log_std.fill_(SMALL_LOG_STD)
    learner = Distillation(student, original.labels, compute)
    torch.set_num_threads(1)  # those of policies and learner are beside operations
    races = each_way(races)
    policies = [DataParallelPolicy(policy, threads) for policy in (driving, original)]
    with closing(_trials(races, train, design.metadata, policies[1], seed)) as trials:
        wanted_laps = trials.evaluate(LAPS, _never).laps
    say(f"{name} drives {wanted_laps}.")
    if wanted_laps.clean < _needed(wanted_laps):
        raise SettingsError(
            f"{name} completes {wanted_laps.clean} of {wanted_laps.driven} laps; to learn from it, "
            f"{_needed(wanted_laps)} are needed. Nothing was written.",
            remedy="Train the model further, or choose another checkpoint with -c.",
        )
    steps, iteration = 0, 0
    best, best_weights = Laps(wanted_laps.driven, []), weights_of(student)
    most = PhaseJudge(many=len(races) > 1).most_steps(_MARK)
    with (
        closing(_Lessons(races, train, design.metadata, policies, seed)) as lessons,
        closing(_trials(races, train, design.metadata, policies[0], seed)) as trials,
    ):
        while steps < most and not _follows(best, wanted_laps):
            rollout = lessons.drive(iteration)
            at = steps if len(races) == 1 else round(steps / most * STUDENT.schedule_steps)
            learner.update(rollout, seed + iteration, steps_before=at)
            steps, iteration = steps + rollout.steps, iteration + 1
            learned = weights_of(student)
            load_arrays(driving, learned)
            if iteration < MIXED_ITERATIONS:
                say(f"{steps:,} steps: {name} still drives at times.")
                continue
            laps = trials.evaluate(LAPS, _never, other_starts=iteration).laps
            say(f"{steps:,} steps: {NETWORK} drives {laps}.")
            if _order(laps) > _order(best):
                best, best_weights = laps, learned
        load_arrays(driving, best_weights)
        # Nobody chose the weights by laps from these starts.
        laps = trials.evaluate(LAPS, _never, other_starts=iteration + 1).laps
    if laps.clean < _needed(laps):
        raise SettingsError(
            f"After {steps:,} steps {NETWORK} completes {laps.clean} of {laps.driven} laps, "
            f"{name} {wanted_laps.clean}; {_needed(laps)} are needed. Nothing was written.",
            remedy="Repeat it with another --seed, or train the model further.",
        )
    load_arrays(student, best_weights | original.deviations)
    state = {layer: tensor.cpu().contiguous() for layer, tensor in student.state_dict().items()}
    seconds = time.monotonic() - began
    return Distilled(wanted, save_tensors(state), steps, seconds, wanted_laps, laps)


def _trials(
    races: Sequence[DriveConfig],
    train: TrainConfig,
    metadata: ModelMetadata,
    policy: Policy,
    seed: int,
) -> HeldOutTracks:
    """Laps from drawn starts under the settings of an evaluation."""
    return HeldOutTracks(
        races,
        metadata,
        Racer(policy, actions_of(metadata)),
        centre_line_reward,
        num_cars=min(max(LAPS, len(races)), MOST_CARS),
        num_threads=usable_cores(train),
        seed=seed,
        start_seed=seed,
        job="evaluation",
    )


def is_needed(design: Design) -> bool:
    """Whether the reference has no such network."""
    spec = policy_spec(design.metadata, design.parameters)
    try:
        refuse_other_networks(spec, is_sac=not design.metadata.algorithm.in_reference)
    except SettingsError:
        return True
    return False


def student_design(design: Design) -> Design:
    """The files of the new network: same sensors, same actions."""
    metadata, parameters = (
        json.loads(design.files[name].decode("utf-8-sig"))
        for name in (keys.MODEL_METADATA_FILE, keys.HYPERPARAMETERS_FILE)
    )
    metadata["neural_network"] = NETWORK
    for other in ("training_method", "critic", "stack_size"):
        parameters.pop(other, None)
    if not design.metadata.algorithm.in_reference:
        metadata["training_algorithm"] = "clipped_ppo"
        parameters.pop("exploration_type", None)
    files = {
        keys.MODEL_METADATA_FILE: json.dumps(metadata, indent=2).encode(),
        keys.HYPERPARAMETERS_FILE: json.dumps(parameters, indent=2).encode(),
    }
    return Design(
        ModelMetadata.from_bytes(files[keys.MODEL_METADATA_FILE], design.metadata_origin),
        Hyperparameters.from_bytes(files[keys.HYPERPARAMETERS_FILE], design.parameters_origin),
        design.metadata_origin,
        design.parameters_origin,
        files,
    )


class Teaching:
    """The model as a policy without a critic, for which every step gets labels."""

    def __init__(self, design: Design, weights: bytes, name: str) -> None:
        self._model: Network = build_policy(design.metadata, design.parameters)
        load_weights(self._model, weights, name)
        self.spec = replace(self._model.spec, state_dims=0, taught=False)
        self.deviations: dict[str, Float32s] = {}
        if self.spec.continuous:
            usual = np.full(self.spec.num_actions, FIRST_LOG_STD, np.float32)
            self.deviations["log_std"] = usual  # those of SAC are outputs
        if self.spec.continuous and isinstance(self._model, ActorCritic):
            self.deviations["log_std"] = self._model.log_std.detach().numpy().copy()
            with torch.no_grad():
                self._model.log_std.fill_(SMALL_LOG_STD)

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        return self._model.act(self._with_state(seen), noise, deterministic, epsilon)

    def labels(self, rollout: Rollout) -> Float32s:
        rows = rollout.stacked_rows(self.spec.stack)
        found = []
        with torch.inference_mode():
            for part in np.array_split(rows, -(-len(rows) // _LABELS_AT_A_TIME)):
                frames = rollout.frames[part].reshape(len(part), -1, *rollout.frames.shape[2:])
                newest = part[:, -1]
                seen = Observation.of_arrays(frames, rollout.scans[newest], rollout.states[newest])
                found.append(self._model.outputs(self._with_state(seen)).numpy())
        return np.concatenate(found)

    def _with_state(self, seen: Observation) -> Observation:
        return seen._replace(state=torch.zeros(len(seen.frames), self._model.spec.state_dims))


class _Lessons:
    """Episodes of model and new network, from anywhere beside the line."""

    def __init__(
        self,
        races: Sequence[DriveConfig],
        train: TrainConfig,
        metadata: ModelMetadata,
        policies: Sequence[Policy],
        seed: int,
    ) -> None:
        tracks = tracks_of(races)
        racers = [Racer(policy, actions_of(metadata)) for policy in policies]
        self._seed = seed
        self._realism = realism_of(races[0], "training")
        self._choice = TrackChoice(len(tracks))
        self._simulation = build_simulation(
            races[0],
            "training",
            metadata,
            tracks,
            num_cars=EPISODES["distillation"],
            reward=centre_line_reward,
            rules=rules_on(tracks, racers[0]),
            num_threads=usable_cores(train),
            seed=seed,
            longest_latency_s=MILD.longest_latency_s,
        )
        self._driver = Driver(self._simulation, racers, seed)

    def drive(self, iteration: int) -> Rollout:
        count = self._simulation.num_cars
        plans = []
        for place in range(count):
            number = iteration * count + place
            track = self._choice.draw(self._seed, number)
            plan = Plan(number, "training", 0.0, track=track)
            teacher = teacher_drives(_MARK, iteration, place)
            plans.append(plan_of_phase(_MARK, plan, self._seed, self._realism, teacher=teacher))
        driven = self._driver.driven(plans)
        for episode in driven:
            self._choice.note(episode.track, float(episode.progress))
        return rollout_of(driven)

    def close(self) -> None:
        self._simulation.close()


def _never() -> bool:
    return False


def each_way(races: Sequence[DriveConfig]) -> list[DriveConfig]:
    """Of each track and direction in which the model was trained, once."""
    trained = [each for race in races for each in training_races(race)]
    trained += [
        each.replaced(train_reverse_direction=not each.train_reverse_direction)
        for each in trained
        if each.train_alternate_driving_direction
    ]
    ways: dict[tuple[str, bool], DriveConfig] = {}
    for each in trained:
        ways.setdefault((each.world_name, each.train_reverse_direction), each)
    return list(ways.values())


def _follows(laps: Laps, wanted: Laps) -> bool:
    """As often clean, and no slower."""
    if laps.median_s is None or wanted.median_s is None:
        return False
    return laps.clean >= wanted.clean and laps.median_s <= (1.0 + FOLLOWS) * wanted.median_s


def _order(laps: Laps) -> tuple[int, float]:
    return laps.clean, -(laps.median_s or math.inf)


def _needed(laps: Laps) -> int:
    return math.ceil(LEAST_CLEAN * laps.driven)
