"""Where a console listens: the standard input of its process."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal

from drcli.base.json_record import SafeInt, decode_json

ENTER = "/enter"
STREAM = "/stream"
USUAL_TOPIC = "/racecar/deepracer/kvs_stream"

TOPICS: Mapping[str, Literal["camera", "chase"]] = {
    USUAL_TOPIC: "chase",
    "/racecar/main_camera/zed/rgb/image_rect_color": "chase",
    "/racecar/camera/zed/rgb/image_rect_color": "camera",
}
"""Of the viewer of DeepRacer-for-Cloud."""


@dataclass(frozen=True)
class Listen:
    """What the process is given.

    Attributes:
        descriptor: A bound socket.
        token: Without one, every user of this machine may use the console.
        secrets: Of the command's environment, such as keys to the bucket.
    """

    descriptor: SafeInt
    token: str
    secrets: dict[str, str] = field(default_factory=dict)

    def line(self) -> bytes:
        return json.dumps(asdict(self)).encode() + b"\n"

    @staticmethod
    def of_line(line: bytes) -> "Listen":
        """Read it, or raise RecordError."""
        return decode_json(Listen, line)
