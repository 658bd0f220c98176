"""Compares an exported graph with its network while it drives."""

from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.convert.build_network import build_policy, load_weights
from drcli.convert.frozen_graph import GraphComparison, compare_graph
from drcli.drive.build_race import actions_of, build_simulation, load_world
from drcli.drive.driving import Driver, Plan, Racer
from drcli.learn.encoders import Network
from drcli.learn.policy import Observation, PolicySpec
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.transfer.export_car import FRAMES, CarExport, export_car
from drcli.workers.cores import cores
from drcli.workers.worker_process import StopRequested
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward

if TYPE_CHECKING:
    from drcli.transfer.export_model import ExportSource

_CARS = 4
_EPISODES = 10_000


def compare_on_drive(
    race: DriveConfig, design: Design, weights: bytes, name: str, graph: bytes, *, frames: int
) -> GraphComparison:
    """Compare what graph and weights do on the track of a race.

    Raises:
        DrError: The track is not installed, the weights do not fit, or the graph cannot be run.
    """
    model = build_policy(design.metadata, design.parameters)
    load_weights(model, weights, name)
    seen = record_drive(race, design.metadata, model, frames)
    return compare_graph(graph, model, seen, f"The graph of {name}")


def record_drive(
    race: DriveConfig, metadata: ModelMetadata, model: Network, frames: int
) -> Observation:
    track = load_world(race)
    simulation = build_simulation(
        race.replaced(race_type="TIME_TRIAL"),
        "training",
        metadata,
        track,
        num_cars=_CARS,
        reward=centre_line_reward,
        rules=EpisodeRules(),
        num_threads=cores(),
        seed=0,
    )
    recorder = _Recorder(model)
    plans = [
        Plan(number, "training", (0.25 * number + 0.013 * (number // 4)) % 1.0)
        for number in range(_EPISODES)
    ]
    with suppress(StopRequested):
        Driver(simulation, [Racer(recorder, actions_of(metadata))], 0).drive(
            plans, lambda episode: None, lambda: recorder.steps >= frames
        )
    simulation.close()
    return recorder.observations(frames)


class _Recorder:
    def __init__(self, model: Network) -> None:
        self._model = model
        self._seen: list[Observation] = []
        self.steps = 0

    @property
    def spec(self) -> PolicySpec:
        return self._model.spec

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        self._seen.append(seen)
        self.steps += len(seen.frames)
        return self._model.act(seen, noise, deterministic, epsilon)

    def observations(self, frames: int) -> Observation:
        parts: Sequence[Sequence[Tensor]] = list(zip(*self._seen, strict=True))
        return Observation(*(torch.cat(list(part))[:frames] for part in parts))


# Makes the archive for the physical car, and compares its graph with the weights.


def made_car_archive(settings: Settings, source: "ExportSource", file_name: str) -> "CarExport":
    """The archive of a checkpoint, checked; nothing is written.

    Raises:
        SettingsError: The car cannot drive the model, or its graph computes something else.
    """
    return export_car(settings, source, file_name, _compare)


def _compare(race: DriveConfig, source: "ExportSource", graph: bytes) -> "GraphComparison":
    return compare_on_drive(
        race, source.design, source.weights, source.chosen.name, graph, frames=FRAMES
    )
