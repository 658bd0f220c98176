"""Exports a checkpoint for the reference simulator."""

from dataclasses import dataclass, field

from drcli.config.settings import Settings
from drcli.exchange.scores import Score
from drcli.models.checkpoint_files import HYPERPARAMETERS, METADATA, Item
from drcli.models.export_model import ExportSource, Selection, read_export_source
from drcli.models.put_model import Progress
from drcli.models.write_export import (
    ExportTarget,
    pointer_items,
    reference_score,
    write_items,
)
from drcli.store import keys
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket

_VERIFIED = (
    "The files were read back, and the {variables} variables in them have the names and shapes of "
    "the reference simulator's list for {network}.",
    "When drcli was developed, TensorFlow 2.12 restored such files of every network and both kinds "
    "of actions; layers built under the reference's names computed the same actions and values.",
)
_NOT_VERIFIED = ("The reference simulator itself has not loaded this checkpoint.",)


@dataclass(frozen=True)
class CheckpointExport:
    source: ExportSource
    items: list[Item]
    score: Score
    notes: list[str]
    verified: list[str]


@dataclass(frozen=True)
class ExportReport:
    """The result of `dr-export tf-checkpoint` and `dr-export droa`.

    Attributes:
        source: The model, as an s3:// address.
        checkpoint: Name of the exported checkpoint.
        target: Folder or s3:// address.
        files: Names of the files there.
        size_bytes: Their size.
        archive: The same files as an archive; None without one.
        notes: What a racer should know.
        verified: What was checked.
        not_verified: What was not, because it needs the other system.
    """

    source: str
    checkpoint: str
    target: str
    files: list[str]
    size_bytes: int
    archive: str | None = None
    notes: list[str] = field(default_factory=list)
    verified: list[str] = field(default_factory=list)
    not_verified: list[str] = field(default_factory=list)


def read_checkpoint_export(settings: Settings, selection: Selection) -> CheckpointExport:
    """Make the files in memory; DrError if the reference cannot use them."""
    from drcli.formats.training_checkpoint import encode_training_checkpoint

    source = read_export_source(settings, selection)
    design, name = source.design, source.chosen.name
    written = encode_training_checkpoint(
        source.weights, source.origin, design.metadata, design.parameters
    )
    items = [Item(f"model/{name}{part}", data) for part, data in written.parts.items()]
    items += [
        Item(f"model/model_{source.chosen.number}.pb", written.graph),
        Item("model/checkpoint", checkpoint_state(name)),
        Item(METADATA, design.files[keys.MODEL_METADATA_FILE]),
        Item(HYPERPARAMETERS, design.files[keys.HYPERPARAMETERS_FILE]),
    ]
    reward = _reward_function(settings, source.prefix)
    if reward is not None:
        items.append(Item(keys.REWARD_FUNCTION_FILE, reward))
    network = design.metadata.neural_network
    verified = [text.format(variables=written.variables, network=network) for text in _VERIFIED]
    score = reference_score(source.chosen.score)
    return CheckpointExport(source, items, score, written.notes, verified)


def export_checkpoint(
    exported: CheckpointExport, target: ExportTarget, progress: Progress
) -> ExportReport:
    """Write the files, the pointers last.

    Raises:
        DrError: It failed; the target has no pointers, or its old files.
    """
    write_items(target, exported.items, exported.score, progress)
    return report_of(exported, target.shown)


def report_of(exported: CheckpointExport, target: str) -> ExportReport:
    items = [*exported.items, *pointer_items(exported.score)]
    return ExportReport(
        source=exported.source.url,
        checkpoint=exported.source.chosen.name,
        target=target,
        files=sorted(item.name for item in items),
        size_bytes=sum(len(item.data) for item in items),
        notes=exported.notes,
        verified=exported.verified,
        not_verified=list(_NOT_VERIFIED),
    )


def checkpoint_state(name: str) -> bytes:
    """The file in which TensorFlow and the old console look."""
    return f'model_checkpoint_path: "{name}"\nall_model_checkpoint_paths: "{name}"\n'.encode()


def _reward_function(settings: Settings, prefix: str) -> bytes | None:
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    places = [keys.reward_function(prefix)]
    if prefix == settings.model.prefix:
        places.append(settings.model.reward_key)
    key = next(filter(bucket.exists, places), None)
    return None if key is None else bucket.get(key)
