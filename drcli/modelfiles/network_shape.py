"""What decides the shape of a model's weights, and whether two models can exchange them."""

from dataclasses import dataclass

from drcli.base.problems import Problem, ProblemsError
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import LIDARS, SINGLE_CAMERAS, ModelMetadata
from drcli.store import keys
from drcli.store.bucket import Bucket


@dataclass(frozen=True)
class Design:
    """The two parameter files of a model, with the places they were read from.

    Attributes:
        metadata: Actions, sensors, network and algorithm.
        parameters: Hyperparameters, some of which shape the network too.
        metadata_origin: Where the first was found, for people.
        parameters_origin: Where the second was found.
    """

    metadata: ModelMetadata
    parameters: Hyperparameters
    metadata_origin: str
    parameters_origin: str

    @staticmethod
    def of_model(bucket: Bucket, prefix: str) -> "Design":
        """The design that a model in the bucket was trained with.

        Raises:
            ObjectMissing: One of its files does not exist.
            ProblemsError: One of them is wrong.
        """
        places = (keys.model_metadata(prefix), keys.hyperparameters(prefix))
        metadata, parameters = (f"{bucket.name}/{key}" for key in places)
        return Design(
            ModelMetadata.from_bytes(bucket.get(places[0]), metadata),
            Hyperparameters.from_bytes(bucket.get(places[1]), parameters),
            metadata,
            parameters,
        )

    def refuse_conflict(self) -> None:
        """Check that the two files fit each other.

        Raises:
            ProblemsError: They do not.
        """
        conflict = self.parameters.conflict(
            self.metadata.training_algorithm, continuous=self.metadata.action_space.continuous
        )
        if conflict is not None:
            place, remedy = self.parameters_origin, "Change one of the two files."
            raise ProblemsError([Problem("V-34", "error", place, None, conflict, remedy)])


def refuse_misfit(trained: Design, wanted: Design, model: str) -> list[Problem]:
    """Check that weights of one model fit another.

    The inputs and outputs of a network are fixed; what its outputs mean may change.

    Args:
        trained: Of the model that has the weights.
        wanted: Of the model that takes them over.
        model: What to call the first in messages.

    Returns:
        Warnings about what fits but means something else.

    Raises:
        ProblemsError: They do not fit; a problem for each key that differs.
    """
    old, new = trained.metadata, wanted.metadata
    where = wanted.metadata_origin
    misfits = [_other_actions(old, new, where, model)]
    misfits += [
        _difference(where, key, before, now, model)
        for key, before, now in (
            ("training_algorithm", old.training_algorithm, new.training_algorithm),
            ("neural_network", old.neural_network, new.neural_network),
            ("sensor", _sensors(old), _sensors(new)),
        )
    ]
    misfits += [
        _difference(wanted.parameters_origin, key, before, now, model)
        for key, before, now in (
            ("stack_size", str(trained.parameters.stack_size), str(wanted.parameters.stack_size)),
            ("critic", trained.parameters.critic, wanted.parameters.critic),
        )
    ]
    problems = [misfit for misfit in misfits if misfit is not None]
    if problems:
        raise ProblemsError(problems)
    if old.action_space == new.action_space:
        return []
    what = (
        f"{model} was trained with other values of action_space, so it has to learn what its "
        "actions do now."
    )
    return [Problem("V-35", "warning", where, None, what, "Go on if you mean it.")]


def _other_actions(
    old: ModelMetadata, new: ModelMetadata, where: str, model: str
) -> Problem | None:
    before, now = (
        f"{count} {each.action_space_type} action{'s' * (count != 1)}"
        for each in (old, new)
        for count in [each.action_space.num_actions]
    )
    if (old.action_space_type, old.action_space.num_actions) == (
        new.action_space_type,
        new.action_space.num_actions,
    ):
        return None
    return Problem(
        "V-35",
        "error",
        where,
        None,
        f"{model} was trained with {before}, but action_space has {now} here.",
        "Keep type and number of actions (their values may change), or start a new model "
        "with fresh weights.",
    )


def _difference(where: str, key: str, before: str, now: str, model: str) -> Problem | None:
    if before == now:
        return None
    return Problem(
        "V-35",
        "error",
        where,
        None,
        f"{key}={now}, but {model} was trained with {key}={before}, and its weights only fit that.",
        f"Write {key}={before} there, or start a new model with fresh weights.",
    )


def _sensors(metadata: ModelMetadata) -> str:
    """What the network gets to see; several names mean the same grey picture."""
    names = ["FRONT_FACING_CAMERA" if s in SINGLE_CAMERAS else s for s in metadata.sensor]
    seen = sorted(names, key=lambda name: name in LIDARS)
    if "DISCRETIZED_SECTOR_LIDAR" in seen:
        lidar = metadata.lidar
        return f"{'+'.join(seen)} ({lidar.num_sectors} x {lidar.num_values_per_sector})"
    return "+".join(seen)
