"""Compares an exported graph with its network while it drives."""

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from drcli.base.errors import SettingsError
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.config.track_names import is_installed
from drcli.convert.build_network import build_policy, load_weights
from drcli.convert.car_archive import CarCheck
from drcli.convert.frozen_graph import GraphComparison, compare_graph
from drcli.convert.tensorflow.graph import decode_graph
from drcli.convert.tensorflow.interpreter import Graph
from drcli.drive.build_race import actions_of, build_simulation, load_world
from drcli.drive.driving import Driver, Plan, Racer
from drcli.learn.encoders import Network
from drcli.learn.policy import Observation, PolicySpec
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.model.files.sensors import CAMERAS, LIDARS
from drcli.transfer.export_car import (
    FRAMES,
    ArchiveReport,
    CarExport,
    OverlayAgreement,
    check_archive,
    export_car,
)
from drcli.workers.cores import cores
from drcli.workers.worker_process import StopRequested
from drsim.arrays import Bytes, Singles
from drsim.car.conditions import draw_gray_overlay
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track
from drsim.track.worlds import load_track

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


# How much of a network's driving the gray overlay of the car's camera changes.


def checked_archive(path: Path, race: DriveConfig | None) -> ArchiveReport:
    """An archive that anybody may have made, checked on the track of a race if it is installed.

    SettingsError if it is unreadable or far too large.
    """
    default = str(DriveConfig.declared["DR_WORLD_NAME"].default)
    known = race is not None and is_installed(race)
    track = load_world(race) if race is not None and known else load_track(default)
    return check_archive(path, partial(overlay_agreement, track))


OVERLAY_FRAMES = 20
_SAME = 0.1
"""Of a continuous action, -1 .. 1."""


def overlay_agreement(track: Track, check: CarCheck) -> OverlayAgreement | None:
    """On pictures from places all over the lap; None if the graph cannot be run."""
    if not check.graph or not any(name in CAMERAS for name in check.sensors):
        return None
    simulation = Simulation(
        track,
        num_cars=OVERLAY_FRAMES,
        reward_function=centre_line_reward,
        num_threads=cores(),
        sensors=Sensors(check.sensors),
    )
    places = np.arange(OVERLAY_FRAMES)
    simulation.reset(
        places,
        places / OVERLAY_FRAMES,
        offset_m=0.15 * np.sin(2.4 * places),
        angle_deg=10.0 * np.cos(2.4 * places),
    )
    overlaid = simulation.frames.copy()
    draw_gray_overlay(overlaid)
    try:
        graph = Graph(decode_graph(check.graph, "The graph"), "The graph")
        plain = _output(graph, simulation.frames, simulation.scans)
        under = _output(graph, overlaid, simulation.scans)
    except SettingsError:
        return None
    finally:
        simulation.close()
    if check.actions[0].index is not None:
        same = plain.argmax(axis=1) == under.argmax(axis=1)
    else:
        same = (np.abs(plain.clip(-1, 1) - under.clip(-1, 1)) <= _SAME).all(axis=1)
    return OverlayAgreement(track.name, OVERLAY_FRAMES, int(same.sum()))


def _output(graph: Graph, eyes: Bytes, scans: Singles) -> Singles:
    """One frame after the other, as on the car, for which some graphs are made. Shape (n, a)."""
    pictures = eyes.transpose(0, 2, 3, 1).astype(np.float32)
    return np.concatenate(
        [
            graph.run(
                {
                    name: (scans if name.rpartition("/")[2] in LIDARS else pictures)[k : k + 1]
                    for name in graph.inputs
                }
            )
            for k in range(len(eyes))
        ]
    )


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
