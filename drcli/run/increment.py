"""Prepares training a model further under a new name: edits run.env."""

import ast
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from drcli.base import errors
from drcli.base.errors import ProblemsError, SettingsError, closest, refuse, shown
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.checks.start_rules import refuse_second_run
from drcli.config.editing import RunEnvEdit, plan_edit, raised, refuse_stronger_values
from drcli.config.loading import load_settings
from drcli.config.presets import model_file
from drcli.config.run_config import StorageConfig
from drcli.config.settings import Settings, catalogue
from drcli.config.track_names import track_problem
from drcli.config.value_types import CheckpointChoice, parse_checkpoint, without_slashes
from drcli.model import keys, lease
from drcli.model.files.custom_files import InputFile, find
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design, weight_problems
from drcli.model.model_prefix import contains, is_used, wipe
from drcli.model.model_store import ModelStore
from drcli.model.repair import repair_unless_trained
from drcli.records.run_record import run_folder
from drcli.records.training_record import Pretrained
from drcli.rewards.reward_rules import read_source, review_source
from drcli.rewards.source import read_files
from drcli.transfer.copy_custom_files import write_file
from drcli.transfer.pretrained import read_weights

# What else changes with the next model: run.env, the racer's own files.


CHECKPOINT = "DR_LOCAL_S3_PRETRAINED_CHECKPOINT"
WORLD = "DR_WORLD_NAME"
DESCRIPTION = "DR_MODEL_DESCRIPTION"


@dataclass(frozen=True)
class Overrides:
    """Options of the command, such as `lr=0.0001`; `reward` replaces reward_function.py."""

    checkpoint: CheckpointChoice | None = None
    world: str | None = None
    reward: Path | None = None
    hyperparameters: Sequence[str] = ()
    settings: Sequence[str] = ()
    description: str | None = None


NO_OVERRIDES = Overrides()


def changed_settings(overrides: Overrides, taken: Sequence[str], before: str) -> dict[str, str]:
    """Texts for run.env; `taken` are names that the command itself changes.

    Raises:
        SettingsError: A text is not NAME=VALUE, or the name is not a setting of run.env.
    """
    values = {}
    if overrides.checkpoint is not None:
        values[CHECKPOINT] = str(overrides.checkpoint)
    if overrides.world is not None:
        values[WORLD] = overrides.world
    if overrides.description is not None or before:
        values[DESCRIPTION] = overrides.description or ""
    for name, value in _pairs(overrides.settings, "--set", "DR_TRAIN_MAX_ITERATIONS=100"):
        if name not in catalogue():
            likely = closest(name, catalogue())
            raise SettingsError(
                f"--set {shown(name)}: there is no such setting.",
                remedy=f"Did you mean {likely}?" if likely else "`dr-config show` lists all.",
            )
        if name in (*taken, *values):
            raise SettingsError(
                f"--set {name}: this command changes it by itself, or by another option.",
                remedy="Leave it out.",
            )
        values[name] = value
    return values


def check_settings(settings: Settings, values: Mapping[str, str]) -> Settings:
    after = load_settings(settings.directory, flags=dict(values))
    problem = track_problem(after.race) if WORLD in values else None
    if problem is not None:
        refuse([replace(problem, severity="error")])
    return after


def changed_files(
    settings: Settings, overrides: Overrides, bucket: Bucket, checkpoint: str
) -> dict[str, bytes]:
    """New contents of files in `custom_files/`, checked.

    Raises:
        ProblemsError: A file or a value is wrong, or the weights do not fit the new values.
        SettingsError: A text is not KEY=VALUE, or the file cannot be read.
    """
    if overrides.reward is None and not overrides.hyperparameters:
        return {}
    found = find(settings.custom_files, bucket)
    changed: dict[str, bytes] = {}
    if overrides.reward is not None:
        changed[keys.REWARD_FUNCTION_FILE] = _reward(overrides.reward, settings.directory)
    if overrides.hyperparameters:
        name = keys.HYPERPARAMETERS_FILE
        base = found.get(name) or InputFile(name, model_file(name).read_bytes(), name)
        changed[name] = _parameters(base, overrides.hyperparameters)
        _refuse_other_shape(settings, bucket, checkpoint, changed[name], found)
    examples = {str(model_file(name)) for name in found}
    for name, file in found.items():  # one file alone would be a mistake before a start
        if file.origin in examples:
            changed.setdefault(name, file.data)
    return changed


def write_files(settings: Settings, changed: Mapping[str, bytes]) -> list[str]:
    """Old files stay as `NAME.bak`; returns paths that have changed."""
    folder = settings.custom_files_dir
    return [str(folder / name) for name, data in changed.items() if write_file(folder / name, data)]


def _reward(path: Path, directory: Path) -> bytes:
    [file] = read_files([path.expanduser()], directory)
    source, problems = read_source(file)
    refuse(problems if source is None else review_source(source))
    if not _defines_reward(file.data):
        raise SettingsError(
            f"--reward {path}: it defines no reward_function.",
            remedy="Write `def reward_function(params):` in it.",
        )
    return file.data


def _defines_reward(data: bytes) -> bool:
    names: set[str] = set()
    for node in ast.walk(ast.parse(data)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in node.names}
    return bool(names & {"reward_function", "*"})


def _parameters(base: InputFile, texts: Sequence[str]) -> bytes:
    try:
        values = json.loads(base.data.decode("utf-8-sig"))
    except ValueError:
        values = None
    if not isinstance(values, dict):
        Hyperparameters.from_bytes(base.data, base.origin)  # says what is wrong with it
        values = {}
    changes = {key: _value(text) for key, text in _pairs(texts, "--hyperparameter", "lr=0.0001")}
    values |= changes
    data = (json.dumps(values, indent=2) + "\n").encode()
    try:
        Hyperparameters.from_bytes(data, "--hyperparameter", chosen=changes)
    except ProblemsError:
        # What was wrong in the file before is told with its own name.
        Hyperparameters.from_bytes(base.data, base.origin)
        raise
    return data


def _refuse_other_shape(
    settings: Settings,
    bucket: Bucket,
    checkpoint: str,
    parameters: bytes,
    found: Mapping[str, InputFile],
) -> None:
    metadata = found.get(keys.MODEL_METADATA_FILE)
    try:
        trained = Design.of_checkpoint(ModelStore(bucket, settings.model_prefix), checkpoint)
    except (ObjectMissing, ProblemsError):
        return  # a start says so
    if metadata is None:
        return
    wanted = Design(
        ModelMetadata.from_bytes(metadata.data, metadata.origin),
        Hyperparameters.from_bytes(parameters, "--hyperparameter"),
        metadata.origin,
        "--hyperparameter",
    )
    model = f"s3://{bucket.name}/{settings.model_prefix}"
    refuse([*wanted.conflicts(), *weight_problems(trained, wanted, model)])


def _pairs(texts: Sequence[str], option: str, example: str) -> Iterator[tuple[str, str]]:
    seen = set()
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip()
        if not equals or not name or name in seen:
            twice = f"{name} is given twice" if name in seen and equals else "it is not KEY=VALUE"
            raise SettingsError(
                f"{option} {shown(text)}: {twice}.", remedy=f"Write it as in {option} {example}."
            )
        seen.add(name)
        yield name, value.strip()


def _value(text: str) -> Any:
    if text in ("True", "False"):
        return text == "True"
    try:
        return json.loads(text)
    except ValueError:
        return text


MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
METRICS = "DR_LOCAL_S3_METRICS_PREFIX"
PRETRAINED = "DR_LOCAL_S3_PRETRAINED"
PRETRAINED_PREFIX = "DR_LOCAL_S3_PRETRAINED_PREFIX"


@dataclass(frozen=True)
class Increment:
    """The change from one model to the next."""

    file: Annotated[str, "The run.env that is edited."]
    backup: Annotated[str, "Copy of the file from before the change."]
    bucket: Annotated[str, "Name of the bucket."]
    before: Annotated[str, "Prefix of the model to continue from."]
    after: Annotated[str, "Prefix of the new model."]
    pretrained: Annotated[
        Pretrained, "The current state of the weights that the new model will start with."
    ]
    wipes: Annotated[bool, "Whether there are objects under the new prefix, which will be deleted."]
    settings: Annotated[dict[str, str], "What else changes in the file, by DR_ name."] = field(
        default_factory=dict
    )
    files: Annotated[
        list[str], "Paths of the racer's own files that change; each old one is kept as NAME.bak."
    ] = field(default_factory=list)

    def __str__(self) -> str:
        return f"{self.after} starts with the weights of {self.pretrained.source()}."


@dataclass(frozen=True)
class PlannedIncrement:
    step: Increment
    edit: RunEnvEdit
    settings: Settings
    files: Mapping[str, bytes]


def plan_increment(
    settings: Settings,
    *,
    prefix: str | None = None,
    delimiter: str | None = None,
    wiping: bool = False,
    overrides: Overrides = NO_OVERRIDES,
) -> PlannedIncrement:
    """Check everything and prepare the edit; nothing is changed yet.

    Without a `prefix`, this raises the number at the end of the present one, after `delimiter`.

    Raises:
        DrError: The first thing that is wrong.
    """
    refuse_second_run(settings.run_id, run_folder(settings.directory, settings.run_id))
    refuse_stronger_values(settings, (MODEL, PRETRAINED, PRETRAINED_PREFIX))
    before = settings.model_prefix
    now = settings.written.get(MODEL) or before
    plain = None if prefix is None else without_slashes(prefix)
    text, after = (plain, plain) if plain is not None else raised(now, before, delimiter)
    _refuse_nested(before, after)
    described = settings.written.get(DESCRIPTION, "")
    others = changed_settings(overrides, (MODEL, METRICS, PRETRAINED, PRETRAINED_PREFIX), described)
    refuse_stronger_values(settings, others)
    _refuse_left_behind(settings, after, others)

    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    store = ModelStore(bucket, after)
    model = ModelStore.of(settings.model, bucket, before)
    repair_unless_trained(model)
    checkpoint = parse_checkpoint(others.get(CHECKPOINT, settings.pretrained_checkpoint))
    place = settings.place(MODEL)
    pretrained, _, sentence = read_weights(model, checkpoint, MODEL, place)
    errors.show(sentence)
    files = changed_files(settings, overrides, bucket, pretrained.name)
    used = is_used(store)
    if used and not wiping:
        raise SettingsError(
            f"s3://{bucket.name}/{after} already contains a model.",
            remedy="Choose another name with -p; -w would delete that model.",
        )
    if used:
        lease.refuse_other_owner(store)
    values = {PRETRAINED: "True", PRETRAINED_PREFIX: before, MODEL: text}
    edit = plan_edit(settings, values, others)
    file, backup = str(edit.path), str(edit.backup)
    paths = [str(settings.custom_files_dir / name) for name in files]
    step = Increment(file, backup, bucket.name, before, after, pretrained, used, others, paths)
    return PlannedIncrement(step, edit, settings, files)


def make_increment(planned: PlannedIncrement, storage: StorageConfig) -> Increment:
    """Wipe the new prefix if asked to, then edit the files, run.env last.

    Raises:
        SettingsError: The file has changed since the check, or cannot be written.
        StorageError: The bucket could not be wiped; the file is as it was.
    """
    planned.edit.check()
    if planned.step.wipes:
        wipe(ModelStore(open_bucket(storage, patience_s=COMMAND_PATIENCE_S), planned.step.after))
    files = write_files(planned.settings, planned.files)
    planned.edit.make()
    return replace(planned.step, files=files)


def _refuse_nested(before: str, after: str) -> None:
    if contains(before, after) or contains(after, before):
        raise SettingsError(
            f"{after} is the model that it would continue."
            if before == after
            else f"{after} would be nested with {before}; wiping one would delete the other.",
            remedy="Choose another name with -p.",
        )


def _refuse_left_behind(settings: Settings, after: str, others: Mapping[str, str]) -> None:
    before = settings.model_prefix
    edited = {MODEL: after, PRETRAINED: "True", PRETRAINED_PREFIX: before, **others}
    metrics = check_settings(settings, edited).metrics_prefix
    if contains(before, metrics):
        raise SettingsError(
            f"{settings.source(METRICS)}: {METRICS}={metrics} would store the metrics of the "
            f"new model together with those of {before}.",
            remedy=f"Write {METRICS}=${MODEL}/metrics.",
        )
