"""Imports a policy of another system, with its files."""

import ast
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import yaml

from drcli.base.errors import DrError, ProblemsError, SettingsError, shown
from drcli.base.files import read_regular
from drcli.base.installation import lazy_imports
from drcli.base.report import BLANK, View, counted
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.loading import load_settings
from drcli.config.presets import model_file
from drcli.config.settings import Settings
from drcli.convert.onnx_reader import read_onnx
from drcli.learn.algorithms import algorithm_named
from drcli.model import keys
from drcli.model.checkpoint_list import HYPERPARAMETERS, METADATA, PARAMETERS_FILE, Item
from drcli.model.files.custom_files import InputFile, local_file
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.params_yaml import moved_training_parameters, training_parameters
from drcli.model.keys import REWARD_FUNCTION_FILE
from drcli.model.model_store import ModelStore
from drcli.model.write_probe import prove_writing
from drcli.records.episode_metrics import encode_metrics
from drcli.records.evaluation_task import CarTrials
from drcli.records.scores import Score
from drcli.transfer.copy_custom_files import write_own_files
from drcli.transfer.download import DownloadOptions
from drcli.transfer.find_checkpoint import (
    Candidate,
    SourceFiles,
    Wanted,
    belonging,
    find_checkpoint,
    open_source,
)
from drcli.transfer.put_model import POINTERS, Delivery, Progress, TransferReport
from drcli.transfer.transfer_buckets import (
    COPY_PATIENCE_S,
    checked_prefix,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
)

if TYPE_CHECKING:
    from drcli.convert.read_graph import ReadPolicy

with lazy_imports():
    from drcli.convert import imported_policy, read_graph

# Looks at a stranger's reward function without running it.


_NAME = "reward_function"


def reward_fault(data: bytes) -> str | None:
    """Why not, or None."""
    try:
        tree = ast.parse(data.decode("utf-8-sig"), REWARD_FUNCTION_FILE)
    except SyntaxError as error:
        return f"line {error.lineno} is not Python ({error.msg})"
    except (ValueError, RecursionError, MemoryError):
        return "it is not Python in UTF-8"
    names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    for node in tree.body:
        if isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names |= {alias.asname or alias.name for alias in node.names}
    return None if _NAME in names else f"it does not define {_NAME}"


# Makes a model's files from another system's policy.


MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
WORLD = "DR_WORLD_NAME"

LEARNING_RATE = 3e-4
"""Greatest `lr` without hyperparameters: the reference's default. With 1e-3, for fresh weights, the
first update of a trained policy changed seven of ten actions' probabilities by more than the
clip range (measured: mean progress fell from 84 to 28 %, six iterations to recover).
"""

_LARGEST_TEXT = 1 << 20


@dataclass(frozen=True)
class ImportOptions:
    """`metadata` and `world` replace the source's."""

    source: str
    prefix: str
    wanted: Wanted | None = None
    metadata: Path | None = None
    world: str | None = None
    local: bool = False
    wipe: bool = False
    dry_run: bool = False
    custom_files: bool = False


@dataclass(frozen=True, kw_only=True)
class ImportedModel(TransferReport):
    """The result of `dr-import`."""

    form: Annotated[str, "What the source's files are."]
    network: Annotated[str, "`neural_network` of the model."]
    num_actions: Annotated[int, "Actions, or dimensions of continuous ones."]
    action_space_type: Annotated[str, "discrete or continuous."]
    sensors: Annotated[list[str], "Its inputs."]
    world: Annotated[str, "The track that it is driven on here."]
    taken: Annotated[list[str], "Names of the source's files that were taken along."]
    shipped: Annotated[list[str], "Names of the shipped files that stand for missing ones."]
    fresh: Annotated[list[str], "What starts fresh, in sentences."]
    verified: Annotated[list[str], "What was checked, in sentences."]
    warnings: Annotated[list[str], "What was corrected or left out, in sentences."]
    custom_files: Annotated[list[str], "The racer's own files that were written, by path."] = field(
        default_factory=list
    )
    other_files: Annotated[list[str], "Files of custom_files/ that differ from the model's."] = (
        field(default_factory=list)
    )
    trials: Annotated[CarTrials | None, "How far it gets with each car; None if not tried."] = None

    def view(self) -> View:
        would, verb = (
            ("Would import", "would be deleted") if self.dry_run else ("Imported", "deleted")
        )
        actions = f"{self.num_actions} {self.action_space_type} actions"
        deleted = counted(len(self.deleted), "file")
        missing = f"Missing, so the shipped ones are used: {', '.join(self.shipped)}"
        return [
            f"{would} {self.source} ({self.form}) to {self.target}: {self.size_text()}.",
            f"{self.checkpoint}: {self.network}, {actions}, {' and '.join(self.sensors)}.",
            self.taken and f"Taken along: {', '.join(self.taken)}",
            self.shipped and missing,
            self.deleted and f"Not part of it and {verb}: {deleted}.",
            *(f"Fresh: {text}" for text in self.fresh),
            *(f"Verified: {text}" for text in self.verified),
            *(f"Wrote {path}" for path in self.custom_files),
            *([] if self.trials is None else [BLANK, *self.trials.view()]),
        ]


class ModelMaker:
    def __init__(
        self,
        settings: Settings,
        options: ImportOptions,
        source: SourceFiles,
        chosen: Candidate,
        policy: "ReadPolicy",
    ) -> None:
        self._settings = settings
        self._options = options
        self._source = source
        self._chosen = chosen
        self._policy = policy
        self._model = source.place(chosen.title)
        self._taken: list[str] = []
        self._shipped: list[str] = []
        self._warnings: list[str] = []

    def model(self) -> tuple[list[Item], ImportedModel]:
        policy, prefix = self._policy, self._options.prefix
        fitted = imported_policy.fit_metadata(*self._metadata(), policy, self._model)
        metadata = fitted.metadata
        self._warnings += fitted.warnings
        parameters = self._hyperparameters(metadata.action_space.continuous)
        first = imported_policy.first_checkpoint(policy, metadata, parameters)
        reward = self._reward_function()
        hyperparameters = parameters.canonical_json(metadata.training_algorithm).encode()
        name = str(self._chosen.name)
        record = imported_policy.first_record(name, first, fitted, parameters)
        described, world = self._training_parameters()
        metrics = keys.training_metrics("metrics")
        items = [
            Item(f"model/{name}.safetensors", first.tensors),
            Item(f"model/{name}.json", record.encode()),
            Item(METADATA, fitted.data),
            Item(HYPERPARAMETERS, hyperparameters),
            Item(keys.REWARD_FUNCTION_FILE, reward),
            Item(self._settings.model.parameters_file, described),
            Item(metrics, encode_metrics([], self._settings.train_best_model_metric)),
        ]
        report = ImportedModel(
            source=self._model,
            target=prefix,
            checkpoint=name,
            dry_run=self._options.dry_run,
            form=self._chosen.form,
            network=policy.network,
            num_actions=policy.num_actions,
            action_space_type=metadata.action_space_type,
            sensors=list(metadata.sensor),
            world=world,
            taken=self._taken,
            shipped=self._shipped,
            fresh=first.fresh,
            verified=[],
            warnings=[*self._warnings, *policy.notes],
        )
        return items, report

    def _metadata(self) -> tuple[bytes, str]:
        given = self._options.metadata
        if given is not None:
            try:
                return read_regular(given), str(given)
            except OSError as e:
                raise SettingsError(
                    f"--metadata {given}: cannot be read ({e.strerror or e}).",
                    remedy="Name a model_metadata.json.",
                ) from e
        found = self._text(keys.MODEL_METADATA_FILE)
        if found is None:
            policy = self._policy
            kind = "continuous" if policy.continuous else "discrete"
            raise SettingsError(
                f"{self._source.origin} has no {keys.MODEL_METADATA_FILE}, which says what the "
                f"{policy.num_actions} {kind} actions of {shown(self._chosen.title)} do.",
                remedy="Give that file of the model with --metadata FILE.",
            )
        return found

    def _text(self, name: str) -> tuple[bytes, str] | None:
        file = belonging(self._source, self._chosen, name)
        if file is None:
            return None
        place = self._source.place(file)
        if self._source.sizes[file] > _LARGEST_TEXT:
            self._warnings.append(f"{place} is too large to be that file, so it is not used.")
            return None
        self._taken.append(file)
        return self._source.read(file), place

    def _not_taken(self, place: str, why: str, instead: str) -> None:
        self._taken.pop()
        self._warnings.append(f"{place} is not used: {why.rstrip('.')}. {instead}")

    def _hyperparameters(self, continuous: bool) -> Hyperparameters:
        shipped = model_file(keys.HYPERPARAMETERS_FILE)
        found = self._text(keys.HYPERPARAMETERS_FILE)
        if found is not None:
            data, place = found
            try:
                read = Hyperparameters.from_bytes(data, place)
                conflict = read.conflict(
                    algorithm_named(self._policy.algorithm), continuous=continuous
                )
            except ProblemsError as error:
                conflict = str(error).splitlines()[0]
            if conflict is None:
                read, warnings = imported_policy.fit_parameters(
                    read, place, self._policy, self._model
                )
                self._warnings += warnings
                return read
            self._not_taken(place, conflict, "The shipped hyperparameters are used.")
        self._shipped.append(keys.HYPERPARAMETERS_FILE)
        read = Hyperparameters.from_bytes(shipped.read_bytes(), str(shipped))
        if read.lr > LEARNING_RATE:
            self._warnings.append(
                f"The shipped {keys.HYPERPARAMETERS_FILE} gets lr={LEARNING_RATE:g} instead of "
                f"{read.lr:g}: larger steps would undo what a trained policy can do."
            )
            read = read.model_copy(update={"lr": LEARNING_RATE})
        return imported_policy.fit_parameters(read, str(shipped), self._policy, self._model)[0]

    def _reward_function(self) -> bytes:
        found = self._text(keys.REWARD_FUNCTION_FILE)
        if found is not None:
            data, place = found
            fault = reward_fault(data)
            if fault is None:
                return data
            self._not_taken(place, fault, "The shipped reward function is used.")
        self._shipped.append(keys.REWARD_FUNCTION_FILE)
        return model_file(keys.REWARD_FUNCTION_FILE).read_bytes()

    def _training_parameters(self) -> tuple[bytes, str]:
        options, settings = self._options, self._settings
        found = self._text(PARAMETERS_FILE)
        if found is not None:
            data, place = found
            try:
                moved = moved_training_parameters(
                    data, settings.bucket, options.prefix, options.world
                )
                return moved, options.world or _world_of(moved) or settings.world_name
            except ValueError as error:
                self._not_taken(place, str(error), "One is made from the settings.")
        flags = {MODEL: options.prefix}
        if options.world:
            flags[WORLD] = options.world
        own = load_settings(settings.directory, flags=flags)
        return training_parameters(own), own.world_name


def _world_of(data: bytes) -> str | None:
    world = yaml.safe_load(data).get("WORLD_NAME")
    return world if isinstance(world, str) and world else None


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
    other = _other_custom_files(settings, options, items, policy.algorithm)
    warnings = report.warnings
    if other:
        told = (
            f"{settings.custom_files_dir} has another {' and another '.join(other)}, which count "
            "more than the model's when it is trained on: replace them with -c, or move them away."
        )
        warnings = [*warnings, told]
    report = replace(report, verified=verified, warnings=warnings, other_files=other)
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
    model = ModelStore(here, options.prefix)
    names = [item.name for item in planned.items]
    if options.dry_run:
        delivery = Delivery(model, lambda more: None)
        new = [item for item in planned.items if not delivery.holds(item)]
        return replace(
            report,
            copied=[item.name for item in new],
            copied_bytes=sum(len(item.data) for item in new),
            unchanged=[item.name for item in planned.items if item not in new],
            deleted=delivery.strays("", names) if options.wipe else [],
        )
    with progress("Importing model", sum(len(item.data) for item in planned.items)) as watch:
        delivery = Delivery(model, watch)
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
        written = write_own_files(model, settings.custom_files_dir)
    return replace(delivery.complete(report), custom_files=written)


def _other_custom_files(
    settings: Settings, options: ImportOptions, items: list[Item], algorithm: str
) -> list[str]:
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
            if own is not None and not _means_the_same(own, item, algorithm):
                other.append(names[item.name])
    return sorted(other)


def _means_the_same(own: InputFile, item: Item, algorithm: str) -> bool:
    """Keys of other algorithms, such as sac_alpha in files of PPO, do not count."""
    if own.data == item.data or item.name != HYPERPARAMETERS:
        return own.data == item.data
    with suppress(ProblemsError):
        mine = Hyperparameters.from_bytes(own.data, own.origin)
        return mine.canonical_json(algorithm).encode() == item.data
    return False


def _check_target(
    settings: Settings, options: ImportOptions, here: Bucket, items: list[Item]
) -> int:
    model = ModelStore(here, options.prefix)
    if options.source.casefold().startswith("s3://") and options.local:
        name, _, prefix = options.source[5:].partition("/")
        if name == here.name:
            refuse_overlap(
                (here, prefix.strip("/")), (here, options.prefix), flag="-t", may_write=False
            )
    refuse_nesting(model, settings.custom_files_prefix, flag="-t")
    refuse_training(model)
    there = here.list(keys.folder(options.prefix))
    delivery = Delivery(model, lambda more: None)
    names = {info.key.removeprefix(keys.folder(options.prefix)) for info in there}
    is_model = any(name in names for name in POINTERS)
    if is_model and not options.wipe and not all(map(delivery.holds, items)):
        raise _taken(here, options.prefix)
    if not options.dry_run:
        prove_writing(model, deletes=True)  # pointers there are deleted first
    return len(there)


def _taken(here: Bucket, prefix: str) -> SettingsError:
    return SettingsError(
        f"s3://{here.name}/{prefix} already contains a model.",
        remedy="Choose another name with -t; -w would delete that model.",
    )


def _read(source: SourceFiles, chosen: Candidate) -> tuple["ReadPolicy", list[str]]:
    origin = source.place(chosen.title)
    if chosen.form == "ONNX":
        nodes = read_onnx(source.read(chosen.files[0]), origin)
        return read_graph.read_nodes(nodes, origin), [_PROVED.format(origin=origin)]
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
