"""The copy of a curriculum in the bucket, to resume on any machine."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class FrozenCurriculum(JsonRecord):
    """`files` has the contents of all files that it names."""

    name: str
    text: str
    files: Mapping[str, str] = field(default_factory=dict)
