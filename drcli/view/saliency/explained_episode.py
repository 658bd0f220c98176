"""An episode with explanations of its steps."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from drcli.base.errors import SettingsError
from drcli.config.run_config import RunConfig
from drcli.drive.build_race import build_simulation, load_world, longest_episode
from drcli.drive.driving import Driven, Driver, Racer
from drcli.drive.evaluator import start_of
from drcli.learn.policy import Observation, PolicySpec
from drcli.records.trace import STATUS_LABELS, Row
from drcli.view.saliency.maps import SaliencyMaps, saliency_maps
from drcli.view.saliency.policy_outputs import ExplainedPolicy, Float32s, PolicyOutputs, outputs_of
from drcli.view.saliency.saliency_options import FINE_SPACING, METHODS, Method, Target
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.track.track import Track
from drsim.track.worlds import directed

# Drives one episode, and keeps what the policy saw.


MOST_STEPS = 3000
"""200 simulated seconds; bounds memory."""


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """An episode, and what its driver saw before each of n choices.

    Attributes:
        track: In the driving direction.
        frames: Shape (n, stack * eyes, 120, 160).
        scans: Shape (n, scan_dims).
        states: For the critic. Shape (n, state_dims).
        rows: Length n.
        last: After the last choice.
    """

    world: str
    track: Track
    frames: NDArray[np.uint8]
    scans: Float32s
    states: Float32s
    rows: tuple[Row, ...]
    last: Row
    notes: tuple[str, ...] = ()

    @property
    def steps(self) -> int:
        return len(self.rows)

    @property
    def outcome(self) -> str:
        return STATUS_LABELS[self.last.status]


def record_episode(
    subject: ExplainedPolicy,
    config: RunConfig,
    *,
    seed: int = 0,
    threads: int = 1,
    should_stop: Callable[[], bool] = lambda: False,
) -> RecordedEpisode:
    """Drive from the evaluation's start, alone, with the likeliest actions.

    It ends off the track or with a crash, as in training, to show what led there.

    Raises:
        ProblemsError: The track is not installed, or too small for the objects.
        SettingsError: It ended before the first choice.
        StopRequested: `should_stop` returned True.
    """
    race, notes = config.race(), list[str]()
    if race.race_type == "HEAD_TO_MODEL":
        race = race.replaced(race_type="TIME_TRIAL")
        notes.append("The model drives alone here, although DR_RACE_TYPE is HEAD_TO_MODEL.")
    track = directed(load_world(race), reverse=config.evaluation.eval_reverse_direction)
    plan, moved = start_of(config.evaluation, track)
    most = min(MOST_STEPS, longest_episode(track, subject.actions))
    simulation = build_simulation(
        race,
        "evaluation",
        subject.metadata,
        track,
        num_cars=1,
        reward=centre_line_reward,  # the picture does not depend on it, and it runs no one's code
        rules=EpisodeRules(max_steps=most),
        num_threads=threads,
        seed=seed,
    )
    eyes = _Eyes(subject)
    driven: list[Driven] = []
    try:
        racer = Racer(eyes, subject.actions)
        Driver(simulation, [racer], seed).drive([replace(plan)], driven.append, should_stop)
    finally:
        simulation.close()
    [episode] = driven
    steps = min(len(eyes.frames), len(episode.rows) - 1)
    if steps < 1:
        raise SettingsError(
            f"The episode on {race.world_name} ended before the first action.",
            remedy="Choose another start with --start-position, or another track with --world.",
        )
    return RecordedEpisode(
        race.world_name,
        track,
        np.concatenate(eyes.frames[:steps]),
        np.concatenate(eyes.scans[:steps]),
        np.concatenate(eyes.states[:steps]),
        tuple(episode.rows[:steps]),
        episode.rows[-1],
        (*notes, *moved),
    )


@dataclass(eq=False)
class _Eyes:
    subject: ExplainedPolicy
    frames: list[NDArray[np.uint8]] = field(default_factory=list)
    scans: list[Float32s] = field(default_factory=list)
    states: list[Float32s] = field(default_factory=list)

    @property
    def spec(self) -> PolicySpec:
        return self.subject.policy.spec

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        self.frames.append(seen.frames.numpy().copy())
        self.scans.append(seen.scan.numpy().copy())
        self.states.append(seen.state.numpy().copy())
        return self.subject.policy.act(seen, noise, deterministic, epsilon)


ROWS, COLUMNS = ("far", "middle", "near"), ("left", "centre", "right")
"""Of the ninths of a picture."""

_STEPS_AT_A_TIME = 128


@dataclass(frozen=True, eq=False)
class ExplainedEpisode:
    """An episode and its explanation.

    Attributes:
        title: Such as `model, checkpoint 12`.
        outputs: For every step.
        chosen: Explained steps, from 0. Length k.
        saliency: Of these.
    """

    title: str
    subject: ExplainedPolicy
    episode: RecordedEpisode
    outputs: PolicyOutputs
    chosen: tuple[int, ...]
    saliency: SaliencyMaps
    notes: tuple[str, ...] = ()


def explain_episode(
    title: str,
    subject: ExplainedPolicy,
    episode: RecordedEpisode,
    chosen: Sequence[int],
    *,
    methods: Collection[Method] = METHODS,
    target: Target = "action",
    spacing: int = FINE_SPACING,
) -> ExplainedEpisode:
    """Raises NotExplainable as `saliency_maps`, ValueError for steps that do not exist."""
    wrong = [step for step in chosen if not 0 <= step < episode.steps]
    if wrong:
        raise ValueError(f"The episode has no step {wrong[0]}: it has {episode.steps}.")
    index = list(chosen)
    saliency = saliency_maps(
        subject,
        episode.frames[index],
        episode.scans[index],
        episode.states[index],
        methods=methods,
        target=target,
        spacing=spacing,
    )
    outputs = _all_outputs(subject, episode)
    notes = _notes(subject, episode, methods, saliency)
    return ExplainedEpisode(title, subject, episode, outputs, tuple(index), saliency, notes)


def spread_steps(steps: int, count: int) -> list[int]:
    return sorted({round(place) for place in np.linspace(0, steps - 1, min(count, steps))})


def shares(values: np.ndarray) -> list[list[float]]:
    """How much of a map lies in each ninth, from the top."""
    total = float(values.sum(dtype=np.float64))
    if not total > 0.0:
        return [[0.0] * 3 for _ in range(3)]
    return [
        [float(part.sum(dtype=np.float64)) / total for part in np.array_split(band, 3, axis=1)]
        for band in np.array_split(values, 3, axis=0)
    ]


def place_of(values: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(int(values.argmax()), values.shape)
    return int(row), int(column)


def sector_bearings(subject: ExplainedPolicy) -> list[tuple[float, float]]:
    """Of `SaliencyMaps.lidar`, degrees to the left."""
    bearings = np.degrees(subject.sensors.lidar_model.bearings_rad)
    half = (bearings[1] - bearings[0]) / 2.0
    return [
        (float(part[0] - half), float(part[-1] + half))
        for part in np.array_split(bearings, subject.sensors.sectors)
    ]


def _all_outputs(subject: ExplainedPolicy, episode: RecordedEpisode) -> PolicyOutputs:
    parts = [
        outputs_of(
            subject,
            Observation.of_arrays(episode.frames[part], episode.scans[part], episode.states[part]),
        )
        for part in (
            slice(begin, begin + _STEPS_AT_A_TIME)
            for begin in range(0, episode.steps, _STEPS_AT_A_TIME)
        )
    ]
    return PolicyOutputs.joined(parts)


def _notes(
    subject: ExplainedPolicy,
    episode: RecordedEpisode,
    methods: Collection[Method],
    saliency: SaliencyMaps,
) -> tuple[str, ...]:
    notes = list(episode.notes)
    if set(methods) - set(saliency.maps):
        notes.append(
            "This policy runs in an engine without gradients, so it has a perturbation map only."
        )
    if subject.sensors.lidar is not None and saliency.lidar is None:
        notes.append("Only --method perturbation explains what the lidar contributes.")
    if saliency.outputs.value is None:
        notes.append("There is no critic in the file of a policy, so no value is shown.")
    elif subject.policy.spec.state_dims:
        notes.append(
            "The critic sees the state of the car instead of the picture (hyperparameter critic)."
        )
    return tuple(notes)
