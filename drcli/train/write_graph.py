"""Writes the frozen graph of a checkpoint, which the physical car loads."""

from safetensors.torch import load as load_tensors

from drcli.convert.frozen_graph import encode_policy
from drcli.learn.policy import PolicySpec
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.model_metadata import ModelMetadata


class GraphWriter:
    """Reads weights from their file, so it can work while the trainer changes them."""

    def __init__(
        self, store: CheckpointStore, spec: PolicySpec, metadata: ModelMetadata, *, enabled: bool
    ) -> None:
        self._store = store
        self._spec = spec
        self._sensors = metadata.sensor
        self._enabled = enabled

    def write(self, number: int, tensors: bytes) -> None:
        if not self._enabled:
            return
        weights = {name: tensor.float().numpy() for name, tensor in load_tensors(tensors).items()}
        self._store.attach_graph(number, encode_policy(weights, self._spec, self._sensors))
