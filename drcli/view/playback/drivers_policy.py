"""Which policy drove a trace, and how it is opened."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.base.errors import DrError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.config.run_config import ModelConfig
from drcli.model import keys
from drcli.model.checkpoint_choice import ModelCheckpoints, find_choice
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_history
from drcli.records.checkpoint import CHECKPOINT_NAME
from drcli.view.playback.stored_traces import StoredTrace
from drcli.view.video.trace_source import FoundTrace

if TYPE_CHECKING:
    from drcli.view.saliency.policy_outputs import ExplainedPolicy

with lazy_imports():
    from drcli.view.saliency import policy_outputs


@dataclass(frozen=True)
class DrivingPolicy:
    """The policy of a trace.

    Attributes:
        checkpoint: Null if unknown.
        available: Checkpoints that can be opened.
        sentence: Why it cannot be shown, or empty.
    """

    checkpoint: int | None
    available: list[int]
    sentence: str


def policy_of(
    model: ModelStore, config: ModelConfig, trace: StoredTrace, found: FoundTrace
) -> DrivingPolicy:
    available = _available(model, config)
    number = _recorded(found)
    if trace.kind == "training":
        number = _of_iteration(model, config, trace.iteration)
    if number is None:
        sentence = "Nobody recorded which checkpoint drove, so no choices are shown."
    elif number in available:
        sentence = ""
    else:
        sentence = (
            f"Checkpoint {number}, which drove, is no longer there: a training keeps the newest, "
            "the best and the milestones."
        )
    if sentence and available:
        sentence += " Another checkpoint can look at the same pictures."
    return DrivingPolicy(number, available, sentence)


def open_checkpoint(model: ModelStore, config: ModelConfig, number: int) -> "ExplainedPolicy":
    """The network, or the frozen graph where only that is left.

    Raises:
        SettingsError: It cannot be found or used.
        StorageError: It is damaged, or the bucket cannot be read.
    """
    name = ""
    try:
        name = find_choice(ModelStore.of(config, model.bucket, model.prefix), number).name
    except SettingsError:
        if not model.bucket.exists(keys.checkpoint_graph(model.prefix, number)):
            raise
    if name:
        return policy_outputs.open_policy(model, name)
    with tempfile.TemporaryDirectory(prefix="dr-policy-") as folder:
        graph, metadata = Path(folder, f"model_{number}.pb"), Path(folder, "model_metadata.json")
        graph.write_bytes(model.bucket.get(keys.checkpoint_graph(model.prefix, number)))
        metadata.write_bytes(model.bucket.get(keys.model_metadata(model.prefix)))
        return policy_outputs.open_policy_file(graph, metadata)


def _available(model: ModelStore, config: ModelConfig) -> list[int]:
    has = ModelCheckpoints.read(ModelStore.of(config, model.bucket, model.prefix))
    there = {info.key for info in has.listed}
    whole = {name.number for name in has.names if not has.missing_parts(str(name))}
    graphs = {
        name.number
        for name in has.names
        if keys.checkpoint_graph(model.prefix, name.number) in there
    }
    return sorted(whole | graphs)


def _recorded(found: FoundTrace) -> int | None:
    recorded = "" if found.recording is None else found.recording.checkpoint
    name = CHECKPOINT_NAME.fullmatch(recorded)
    return None if name is None else int(name[1])


def _of_iteration(model: ModelStore, config: ModelConfig, iteration: int) -> int:
    """Where driving and learning overlap, an older checkpoint drove."""
    try:
        records, _ = readable_history(ModelStore.of(config, model.bucket, model.prefix))
    except DrError:
        records = []
    for record in records:
        name = CHECKPOINT_NAME.fullmatch(record.checkpoint)
        if record.iteration == iteration and name is not None:
            return int(name[1])
    return iteration
