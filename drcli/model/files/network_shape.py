"""Checks whether one model's weights fit another."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from drcli.base.errors import Problem
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.sensors import CONFIGURED_LIDARS, usual_names
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointRecord


@dataclass(frozen=True)
class Design:
    """Two parameter files, and where each was read."""

    metadata: ModelMetadata
    parameters: Hyperparameters
    metadata_origin: str
    parameters_origin: str
    files: Mapping[str, bytes] = field(default_factory=dict)

    @staticmethod
    def of_checkpoint(model: ModelStore, name: str) -> "Design":
        """By `own_files`; raises ObjectMissing or ProblemsError."""
        try:
            record = CheckpointStore(model).record(name)
        except (ObjectMissing, ObjectDamaged):
            return Design.of_model(model)
        return Design.of_record(model, record)

    @staticmethod
    def of_record(model: ModelStore, record: CheckpointRecord) -> "Design":
        """Raises as `of_checkpoint`."""
        source = f"in {model.bucket.name}/{keys.checkpoint_record(model.prefix, record.name)}"
        return Design.of_model(model, record.counters.inputs, source)

    @staticmethod
    def of_model(
        model: ModelStore,
        inputs: Mapping[str, str] | None = None,
        source: str = "of this start",
    ) -> "Design":
        """What a start trains with: its `Job.inputs`, else the model's files.

        An existing checkpoint may differ, see `of_checkpoint`. Raises as that.
        """
        files, origins = {}, []
        for name, key in model_files(model.prefix).items():
            own = (inputs or {}).get(name)
            files[name] = model.bucket.get(key) if own is None else own.encode()
            origins.append(f"{model.bucket.name}/{key}" if own is None else f"{name} {source}")
        metadata, parameters = files.values()
        return Design(
            ModelMetadata.from_bytes(metadata, origins[0]),
            Hyperparameters.from_bytes(parameters, origins[1]),
            origins[0],
            origins[1],
            files,
        )

    @property
    def texts(self) -> dict[str, str]:
        """As in a checkpoint's record."""
        return {name: data.decode("utf-8-sig") for name, data in self.files.items()}

    def conflicts(self) -> list[Problem]:
        conflict = self.parameters.conflict(
            self.metadata.algorithm, continuous=self.metadata.action_space.continuous
        )
        if conflict is None:
            return []
        place, remedy = self.parameters_origin, "Change one of the two files."
        if self.parameters.taught and not self.metadata.algorithm.teachable:
            remedy = (
                "Start with --no-teacher or remove training_method, or write "
                '"training_algorithm": "clipped_ppo" into model_metadata.json.'
            )
        return [Problem("V-34", "error", place, None, conflict, remedy)]


def model_files(prefix: str) -> dict[str, str]:
    return {
        keys.MODEL_METADATA_FILE: keys.model_metadata(prefix),
        keys.HYPERPARAMETERS_FILE: keys.hyperparameters(prefix),
    }


def own_files(model: ModelStore, checkpoint: str) -> dict[str, bytes]:
    """From a checkpoint's record; for TensorFlow's and old ones, the model's."""
    inputs: Mapping[str, str] = {}
    with suppress(ObjectMissing, ObjectDamaged):
        inputs = CheckpointStore(model).record(checkpoint).counters.inputs
    found = {}
    for name, key in model_files(model.prefix).items():
        if name in inputs:
            found[name] = inputs[name].encode()
        else:
            with suppress(ObjectMissing):
                found[name] = model.bucket.get(key)
    return found


def weight_problems(trained: Design, wanted: Design, model: str) -> list[Problem]:
    """A warning if only the actions changed; `model` names the trained one."""
    old, new = trained.metadata, wanted.metadata
    where = wanted.metadata_origin
    before, now = trained.parameters, wanted.parameters
    differences = [
        (where, "training_algorithm", old.training_algorithm, new.training_algorithm),
        (where, "neural_network", old.neural_network, new.neural_network),
        (where, "sensor", _sensors(old), _sensors(new)),
        (wanted.parameters_origin, "stack_size", str(before.stack_size), str(now.stack_size)),
        (wanted.parameters_origin, "critic", before.critic, now.critic),
    ]
    found = [] if _actions(old) == _actions(new) else [_other_actions(old, new, where, model)]
    found += [_difference(*each, model) for each in differences if each[2] != each[3]]
    if not found and old.action_space != new.action_space:
        what = (
            f"{model} was trained with other values of action_space, so it has to learn what its "
            "actions do now."
        )
        found = [Problem("V-35", "warning", where, None, what, "Continue if this is intended.")]
    return found


def _actions(metadata: ModelMetadata) -> str:
    count = metadata.action_space.num_actions
    return f"{count} {metadata.action_space_type} action{'s' * (count != 1)}"


def _other_actions(old: ModelMetadata, new: ModelMetadata, where: str, model: str) -> Problem:
    what = f"{model} was trained with {_actions(old)}, but action_space has {_actions(new)} here."
    remedy = "Keep the type and number of actions (the values may change), or start a new model."
    return Problem("V-35", "error", where, None, what, remedy)


def _difference(where: str, key: str, before: str, now: str, model: str) -> Problem:
    what = (
        f"{key}={now}, but {model} was trained with {key}={before}, and its weights only fit that."
    )
    remedy = f"Write {key}={before} there, or start a new model with fresh weights."
    return Problem("V-35", "error", where, None, what, remedy)


def _sensors(metadata: ModelMetadata) -> str:
    seen = usual_names(metadata.sensor)
    if seen[-1] in CONFIGURED_LIDARS:
        lidar = metadata.lidar
        return f"{'+'.join(seen)} ({lidar.num_sectors} x {lidar.num_values_per_sector})"
    return "+".join(seen)
