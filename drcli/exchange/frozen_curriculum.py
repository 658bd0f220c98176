"""The copy of a curriculum in the bucket, to resume on any machine."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class FrozenCurriculum(JsonRecord):
    name: str
    text: str
    files: Mapping[str, str] = field(default_factory=dict)
