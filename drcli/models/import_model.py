"""Imports a policy of another system, with its files."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from drcli.base.errors import DrError, SettingsError
from drcli.config.settings import Settings
from drcli.exchange.scores import Score
from drcli.modelfiles.custom_files import local_file
from drcli.models.checkpoint_files import HYPERPARAMETERS, METADATA, Item
from drcli.models.copy_custom_files import write_own_files
from drcli.models.download import DownloadOptions
from drcli.models.find_checkpoint import Candidate, find_checkpoint
from drcli.models.imported_model import ImportedModel, ImportOptions, ModelMaker
from drcli.models.put_model import POINTERS, Delivery, Progress
from drcli.models.source_files import SourceFiles, open_source
from drcli.models.transfer_buckets import (
    COPY_PATIENCE_S,
    checked_prefix,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
)
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.write_probe import prove_writing

if TYPE_CHECKING:
    from drcli.formats.read_graph import ReadPolicy


@dataclass(frozen=True)
class PlannedImport:
    options: ImportOptions
    items: list[Item]
    score: Score
    report: ImportedModel
    used: int


def plan_import(settings: Settings, options: ImportOptions) -> PlannedImport:
    """Check both ends, and make the model in memory; raises DrError."""
    options = replace(options, prefix=checked_prefix(options.prefix, "-t"))
    source = open_source(settings.transfer, options.source, local=options.local)
    chosen = find_checkpoint(source, options.wanted)
    policy, verified = _read(source, chosen)
    made = ModelMaker(settings, options, source, chosen, policy)
    items, report = made.model()
    warnings = [*report.warnings, *_other_custom_files(settings, options, items)]
    report = replace(report, verified=verified, warnings=warnings)
    here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    used = _check_target(settings, options, here, items)
    target = f"s3://{here.name}/{options.prefix}"
    return PlannedImport(
        options, items, Score(str(chosen.name)), replace(report, target=target), used
    )


def copy_of_own(settings: Settings, options: ImportOptions) -> DownloadOptions:
    """How a model of ours, found by `plan_import`, is copied.

    Raises:
        SettingsError: The name is taken, or only a part is wanted.
        StorageError: The bucket cannot be read.
    """
    if options.wanted is not None or options.metadata is not None or options.world is not None:
        raise SettingsError(
            f"{options.source} is a model of drcli, which is copied as it is.",
            remedy="Leave out -b, --checkpoint, --metadata and --world.",
        )
    prefix = checked_prefix(options.prefix, "-t")
    here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    if not options.wipe and any(here.exists(keys.folder(prefix) + name) for name in POINTERS):
        raise _taken(here, prefix)
    return DownloadOptions(
        options.source,
        prefix,
        wipe=options.wipe,
        dry_run=options.dry_run,
        custom_files=options.custom_files,
    )


def import_model(planned: PlannedImport, settings: Settings, progress: Progress) -> ImportedModel:
    """Write the model, the pointers last.

    Raises:
        DrError: It failed; it can be repeated.
    """
    options, report = planned.options, planned.report
    here = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    names = [item.name for item in planned.items]
    if options.dry_run:
        delivery = Delivery(here, options.prefix, lambda more: None)
        new = [item for item in planned.items if not delivery.holds(item)]
        return replace(
            report,
            copied=[item.name for item in new],
            copied_bytes=sum(len(item.data) for item in new),
            unchanged=[item.name for item in planned.items if item not in new],
            deleted=delivery.strays("", names) if options.wipe else [],
        )
    with progress("Importing model", sum(len(item.data) for item in planned.items)) as watch:
        delivery = Delivery(here, options.prefix, watch)
        delivery.withdraw()
        # Rollouts and evaluations of an earlier model of this name would be taken for its own.
        for folder in (keys.rollouts_folder(options.prefix), keys.run_folder(options.prefix)):
            here.delete([info.key for info in here.list(folder)])
        delivery.send(planned.items)
        delivery.delete_strays("" if options.wipe else "model/")
        delivery.publish(planned.score)
        delivery.confirm(names)
    written = []
    if options.custom_files:
        written = write_own_files(here, options.prefix, settings.custom_files_dir)
    return replace(delivery.complete(report), custom_files=written)


def _other_custom_files(settings: Settings, options: ImportOptions, items: list[Item]) -> list[str]:
    if options.custom_files:
        return []
    folder = settings.custom_files_dir
    names = {
        keys.REWARD_FUNCTION_FILE: keys.REWARD_FUNCTION_FILE,
        METADATA: keys.MODEL_METADATA_FILE,
        HYPERPARAMETERS: keys.HYPERPARAMETERS_FILE,
    }
    other = []
    for item in items:
        if item.name in names:
            own = local_file(folder, names[item.name])
            if own is not None and own.data != item.data:
                other.append(names[item.name])
    if not other:
        return []
    return [
        f"{folder} has another {' and another '.join(sorted(other))}, which count more than the "
        "model's when it is trained on: replace them with -c, or move them away."
    ]


def _check_target(
    settings: Settings, options: ImportOptions, here: Bucket, items: list[Item]
) -> int:
    if options.source.casefold().startswith("s3://") and options.local:
        name, _, prefix = options.source[5:].partition("/")
        if name == here.name:
            refuse_overlap(
                (here, prefix.strip("/")), (here, options.prefix), flag="-t", may_write=False
            )
    refuse_nesting(here, options.prefix, settings.custom_files_prefix, flag="-t")
    refuse_training(here, options.prefix)
    there = here.list(keys.folder(options.prefix))
    delivery = Delivery(here, options.prefix, lambda more: None)
    names = {info.key.removeprefix(keys.folder(options.prefix)) for info in there}
    is_model = any(name in names for name in POINTERS)
    if is_model and not options.wipe and not all(map(delivery.holds, items)):
        raise _taken(here, options.prefix)
    if not options.dry_run:
        prove_writing(here, options.prefix, deletes=True)  # pointers there are deleted first
    return len(there)


def _taken(here: Bucket, prefix: str) -> SettingsError:
    return SettingsError(
        f"s3://{here.name}/{prefix} already contains a model.",
        remedy="Choose another name with -t; -w would delete that model.",
    )


def _read(source: SourceFiles, chosen: Candidate) -> tuple["ReadPolicy", list[str]]:
    from drcli.formats import imported_policy

    origin = source.place(chosen.title)
    if chosen.form == "ONNX":
        return _read_onnx(source.read(chosen.files[0]), origin)
    if chosen.form == "frozen graph":
        policy = imported_policy.read_frozen_graph(source.read(chosen.files[0]), origin)
        return policy, [_PROVED.format(origin=origin)]
    index, *data = chosen.files
    policy = imported_policy.read_bundle_policy(
        source.read(index), [source.read(file) for file in data], origin
    )
    verified = [
        f"{origin}: the checksums of all variables are right, and their names and shapes are those "
        f"of {policy.network}."
    ]
    folder = f"{chosen.folder}/" if chosen.folder else ""
    graph = f"{folder}model_{chosen.name.number}.pb"
    if graph in source.sizes:
        try:
            same = imported_policy.same_policy(
                policy, imported_policy.read_frozen_graph(source.read(graph), source.place(graph))
            )
        except DrError as error:
            policy.notes.append(f"The frozen graph beside the checkpoint was not compared: {error}")
        else:
            if same:
                verified.append(f"{source.place(graph)} has the same weights, bit for bit.")
            else:
                policy.notes.append(
                    f"{source.place(graph)} has other weights than the checkpoint, which counts."
                )
    return policy, verified


_PROVED = "{origin} and the network here gave the same results for the same pictures."


def _read_onnx(data: bytes, origin: str) -> tuple["ReadPolicy", list[str]]:
    from drcli.formats.onnx_reader import read_onnx
    from drcli.formats.read_graph import read_nodes

    return read_nodes(read_onnx(data, origin), origin), [_PROVED.format(origin=origin)]
