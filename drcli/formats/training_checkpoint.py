"""Turns our checkpoints into files of the reference's."""

from dataclasses import dataclass

from drcli.formats.build_network import build_policy, load_weights, policy_spec, weights_of
from drcli.formats.frozen_graph import policy_nodes
from drcli.formats.reference_checkpoint import (
    encode_reference_checkpoint,
    export_notes,
    reference_variables,
    refuse_other_networks,
)
from drcli.formats.tensorflow.graph import encode_graph
from drcli.formats.tensorflow.meta_graph import encode_meta_graph
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata

META = ".meta"


@dataclass(frozen=True)
class TrainingCheckpoint:
    """A checkpoint as the reference's trainer has it.

    Attributes:
        parts: By the ends of their names.
        graph: `model_<N>.pb`.
        notes: For the racer.
    """

    parts: dict[str, bytes]
    graph: bytes
    variables: int
    notes: list[str]


def encode_training_checkpoint(
    weights: bytes, origin: str, metadata: ModelMetadata, parameters: Hyperparameters
) -> TrainingCheckpoint:
    """SettingsError if the reference has no such network, or the weights do not fit."""
    spec = policy_spec(metadata, parameters)
    refuse_other_networks(spec, is_sac=metadata.training_algorithm == "sac")
    model = build_policy(metadata, parameters)
    load_weights(model, weights, origin)
    arrays = weights_of(model)
    variables = reference_variables(arrays, spec, metadata.sensor)
    nodes = policy_nodes(arrays, spec, metadata.sensor)
    parts = encode_reference_checkpoint(variables)
    parts[META] = encode_meta_graph(nodes, variables)
    notes = export_notes(arrays, spec)
    return TrainingCheckpoint(parts, encode_graph(nodes), len(variables), notes)
