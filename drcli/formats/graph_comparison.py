"""Compares a frozen graph with its network."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.formats.tensorflow.graph import decode_graph
from drcli.formats.tensorflow.interpreter import Graph
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import Observation
from drcli.learn.sac_networks import SACAgent
from drcli.modelfiles.model_metadata import LIDARS

TOLERANCE = 1e-4
"""Rounding alone stays below 1e-5."""

LEAST_SAME_ACTIONS = 0.999
_BATCH = 32
"""Keeps the interpreter's memory small."""

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class GraphComparison:
    """How a graph and its network differ.

    Attributes:
        same_actions: Frames with the same likeliest action, or continuous actions within 1e-4.
        greatest_difference: Of a probability, or of an action from -1 to 1.
    """

    frames: int
    same_actions: int
    greatest_difference: float

    @property
    def is_equal(self) -> bool:
        same = self.same_actions >= LEAST_SAME_ACTIONS * self.frames
        return same and self.greatest_difference <= TOLERANCE


def compare_graph(
    data: bytes, model: ActorCritic | SACAgent, seen: Observation, origin: str
) -> GraphComparison:
    """SettingsError if the graph cannot run."""
    graph = Graph(decode_graph(data, origin), origin)
    steps = len(seen.frames)
    wanted, got = [], []
    for first in range(0, steps, _BATCH):
        part = seen.part(slice(first, first + _BATCH))
        wanted.append(policy_output(model, part))
        got.append(graph.run(graph_inputs(graph, part)))
    expected, found = np.concatenate(wanted), np.concatenate(got)
    if found.shape != expected.shape:
        raise SettingsError(
            f"{origin} has {found.shape[-1]} outputs, but its network has {expected.shape[-1]}.",
            remedy="Export the model again.",
        )
    return compare_outputs(expected, found, continuous=model.spec.continuous)


def compare_outputs(expected: Floats, found: Floats, *, continuous: bool) -> GraphComparison:
    if not np.isfinite(found).all():
        return GraphComparison(len(found), 0, float("inf"))
    differences = np.abs(expected.astype(np.float64) - found)
    if continuous:
        same = (np.abs(expected.clip(-1, 1) - found.clip(-1, 1)) <= TOLERANCE).all(axis=1)
    else:
        # Two actions that are equally likely may change places when they are rounded.
        chosen = np.take_along_axis(expected, found.argmax(axis=1)[:, None], axis=1)[:, 0]
        same = chosen >= expected.max(axis=1) - TOLERANCE / 10
    return GraphComparison(len(found), int(same.sum()), float(differences.max(initial=0.0)))


def policy_output(model: ActorCritic | SACAgent, seen: Observation) -> Floats:
    """Shape (n, num_actions)."""
    with torch.inference_mode():
        if isinstance(model, SACAgent):
            output = torch.tanh(model(model.features(seen))[0])
        else:
            output = model(seen).policy
            if not model.spec.continuous:
                output = torch.softmax(output, dim=-1)
    array: Floats = output.float().numpy()
    return array


def graph_inputs(graph: Graph, seen: Observation) -> dict[str, Floats]:
    """Pictures with channels last, lidar values."""
    frames = seen.frames.permute(0, 2, 3, 1).float().numpy()
    scan = seen.scan.float().numpy()
    return {name: scan if name.rpartition("/")[2] in LIDARS else frames for name in graph.inputs}
