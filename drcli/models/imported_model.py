"""Makes a model's files from another system's policy."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from drcli.base.errors import SettingsError
from drcli.base.problems import ProblemsError, shown
from drcli.base.regular_file import read_regular
from drcli.config.example_files import model_file
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.exchange.car_trial import CarTrials
from drcli.exchange.episode_metrics import encode_metrics
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.params_yaml import moved_training_parameters, training_parameters
from drcli.models.checkpoint_files import HYPERPARAMETERS, METADATA, PARAMETERS_FILE, Item
from drcli.models.find_checkpoint import Candidate, Wanted, belonging
from drcli.models.put_model import TransferReport
from drcli.models.reward_file import reward_fault
from drcli.models.source_files import SourceFiles
from drcli.store import keys

if TYPE_CHECKING:
    from drcli.formats.read_graph import ReadPolicy

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
    """The result of `dr-import`.

    Attributes:
        form: What the source's files are.
        network: `neural_network` of the model.
        num_actions: Actions, or dimensions of continuous ones.
        action_space_type: discrete or continuous.
        sensors: Its inputs.
        world: The track that it is driven on here.
        taken: Names of the source's files that were taken along.
        shipped: Names of the shipped files that stand for missing ones.
        fresh: What starts fresh, in sentences.
        verified: What was checked, in sentences.
        warnings: What was corrected or left out, in sentences.
        custom_files: The racer's own files that were written, by path.
        trials: How far it gets with each car; None if not tried.
    """

    form: str
    network: str
    num_actions: int
    action_space_type: str
    sensors: list[str]
    world: str
    taken: list[str]
    shipped: list[str]
    fresh: list[str]
    verified: list[str]
    warnings: list[str]
    custom_files: list[str] = field(default_factory=list)
    trials: CarTrials | None = None


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
        from drcli.formats import imported_policy

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
        from drcli.formats.imported_policy import fit_parameters

        shipped = model_file(keys.HYPERPARAMETERS_FILE)
        found = self._text(keys.HYPERPARAMETERS_FILE)
        if found is not None:
            data, place = found
            try:
                read = Hyperparameters.from_bytes(data, place)
                conflict = read.conflict(self._policy.algorithm, continuous=continuous)
            except ProblemsError as error:
                conflict = str(error).splitlines()[0]
            if conflict is None:
                read, warnings = fit_parameters(read, place, self._policy, self._model)
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
        return fit_parameters(read, str(shipped), self._policy, self._model)[0]

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
