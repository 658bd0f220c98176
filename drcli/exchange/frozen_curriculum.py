"""The copy of a curriculum below the model prefix, from which any machine can resume."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class FrozenCurriculum(JsonRecord):
    """A curriculum with all files that it names.

    Attributes:
        name: Of the file, as its author calls it.
        text: Its content.
        files: The contents of the reward functions and hyperparameters, by the names in the file.
    """

    name: str
    text: str
    files: Mapping[str, str] = field(default_factory=dict)
