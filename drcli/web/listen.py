"""Where a console listens: what its process reads from its standard input."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal

from drcli.base.json_record import from_json

ENTER = "/enter"
"""Page that takes a token and gives the cookie for it."""

STREAM = "/stream"
"""Pictures as MJPEG."""

USUAL_TOPIC = "/racecar/deepracer/kvs_stream"

TOPICS: Mapping[str, Literal["camera", "chase"]] = {
    USUAL_TOPIC: "chase",
    "/racecar/main_camera/zed/rgb/image_rect_color": "chase",
    "/racecar/camera/zed/rgb/image_rect_color": "camera",
}
"""Topics of the viewer of DeepRacer-for-Cloud, and what is shown for each."""


@dataclass(frozen=True)
class Listen:
    """What the process is given.

    Attributes:
        descriptor: A socket that is bound to address and port.
        token: Without one, every user of this machine may use the console.
        secrets: Of the environment of the command, such as keys to the bucket.
    """

    descriptor: int
    token: str
    secrets: dict[str, str] = field(default_factory=dict)

    def line(self) -> bytes:
        """As one line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"

    @staticmethod
    def of_line(line: bytes) -> "Listen":
        """The same, read.

        Raises:
            RecordError: It is not such a line.
        """
        return from_json(Listen, json.loads(line))
