"""Drives one episode, and keeps what the policy saw."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from drcli.base.errors import SettingsError
from drcli.config.run_config import RunConfig
from drcli.exchange.trace import STATUS_LABELS, Row
from drcli.learn.policy import Observation, PolicySpec
from drcli.saliency.policy_outputs import ExplainedPolicy, Float32s
from drcli.workers.build_race import build_simulation, load_world, longest_episode
from drcli.workers.driven_episode import Driven
from drcli.workers.driving import Driver, Racer
from drcli.workers.evaluator import start_of
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.track.track import Track
from drsim.track.worlds import directed

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
