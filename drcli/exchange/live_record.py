"""What a simulation worker shows to viewers on this machine while it drives.

The worker writes where it listens (`LiveAddress`), a viewer says what it wants (`LiveRequest`), and
the worker sends pictures, scenes and states (`LiveMessage`). All of it is JSON or JPEG. How it
travels is in `live_wire`.
"""

import json
import os
import secrets
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from drcli.base.atomic_file import load_record, write_private_json
from drcli.base.json_record import JsonRecord, RecordError, from_json, parse_json
from drcli.base.process_identity import is_alive, started_s

LiveView = Literal["camera", "chase", "scene", "state"]
"""What a worker can show: what a car sees, the view from behind it, where all cars are and how they
do, and what the worker does. Every viewer gets the state."""

LIVE_VIEWS: tuple[LiveView, ...] = get_args(LiveView)

PROTOCOL = 1
"""Version of what travels. A viewer does not connect to a worker of another version."""

LIVE_FILES = "live-*.json"

MOST_CAR = 1 << 20

_HEADER_BYTES = 2


def live_file(folder: Path, name: str) -> Path:
    """The file in which the worker of this name says where it listens."""
    return folder / LIVE_FILES.replace("*", name)


@dataclass(frozen=True)
class LiveAddress:
    """Where a worker listens on this machine, in a file that only this user can read.

    Attributes:
        port: On 127.0.0.1.
        key: Both sides prove that they know it; it never travels. 64 hexadecimal digits.
        pid: The worker.
        pid_started: From `process_identity.started_s`, because process numbers are reused.
        protocol: See `PROTOCOL`.
    """

    port: int
    key: str
    pid: int
    pid_started: float
    protocol: int = PROTOCOL

    @staticmethod
    def own(port: int) -> "LiveAddress":
        """The address of this process, with a new key."""
        pid = os.getpid()
        return LiveAddress(port, secrets.token_hex(32), pid, started_s(pid) or 0.0)

    @property
    def secret(self) -> bytes:
        """The key as bytes."""
        return self.key.encode("ascii", "replace")

    @property
    def is_usable(self) -> bool:
        """Whether its worker runs, and speaks this protocol."""
        return (
            self.protocol == PROTOCOL
            and 0 < self.port < 1 << 16
            and len(self.key) >= 32
            and is_alive(self.pid, self.pid_started)
        )

    def write(self, folder: Path, name: str) -> None:
        """Replace the file of the worker of this name.

        Raises:
            OSError: It cannot be written.
        """
        write_private_json(live_file(folder, name), asdict(self))

    def delete(self, folder: Path, name: str) -> None:
        """Delete the file, unless another process of the same name has written it anew."""
        if LiveAddress.read(live_file(folder, name)) == self:
            with suppress(OSError):
                live_file(folder, name).unlink(missing_ok=True)

    @staticmethod
    def read(path: Path) -> "LiveAddress | None":
        """An address; None if the file does not exist or is damaged."""
        return load_record(LiveAddress, path)


@dataclass(frozen=True)
class LiveRequest:
    """What a viewer wants to see from now on.

    Attributes:
        views: `LIVE_VIEWS`; the state comes in any case.
        car: Of the worker's cars, counted from 0; None for the one that has come furthest.
    """

    views: tuple[LiveView, ...] = ()
    car: int | None = None

    def encode(self) -> bytes:
        """As it travels."""
        return json.dumps({"views": sorted(self.views), "car": self.car}).encode()

    @staticmethod
    def decode(data: bytes) -> "LiveRequest":
        """Read a request; RecordError if it is damaged."""
        request = from_json(LiveRequest, parse_json(data))
        if request.car is not None and not 0 <= request.car < MOST_CAR:
            raise RecordError("'car' is not the number of a car")
        return request


@dataclass(frozen=True)
class LiveMessage:
    """Something that a worker shows.

    Attributes:
        view: What it is.
        step_s: Unix time at which its step was driven; of a state, at which it began.
        data: JPEG, or JSON of a `LiveScene` or `LiveState`.
        car: Which of the worker's cars is seen; None in a state, and where none drives.
        width: Of a picture, pixels.
        height: Of a picture.
    """

    view: LiveView
    step_s: float
    data: bytes
    car: int | None = None
    width: int = 0
    height: int = 0

    def encode(self) -> bytes:
        """As it travels: the length of the header in two bytes, the header as JSON, the data."""
        header = {"view": self.view, "step_s": self.step_s}
        if self.car is not None:
            header["car"] = self.car
        if self.width:
            header |= {"width": self.width, "height": self.height}
        text = json.dumps(header, allow_nan=False).encode()
        return len(text).to_bytes(_HEADER_BYTES, "big") + text + self.data

    @staticmethod
    def decode(data: bytes) -> "LiveMessage":
        """Read a message; RecordError if it is damaged."""
        begin = _HEADER_BYTES + int.from_bytes(data[:_HEADER_BYTES], "big")
        if len(data) < begin:
            raise RecordError("it ends too early")
        header = from_json(_Header, parse_json(data[_HEADER_BYTES:begin]))
        return LiveMessage(data=data[begin:], **asdict(header))

    @property
    def scene(self) -> "LiveScene":
        """The scene in it; RecordError if it is damaged or not a scene."""
        return LiveScene.decode(self.data)

    @property
    def state(self) -> "LiveState":
        """The state in it; RecordError if it is damaged or not a state."""
        return LiveState.decode(self.data)


@dataclass(frozen=True)
class _Header:
    view: LiveView
    step_s: float
    car: int | None = None
    width: int = 0
    height: int = 0


@dataclass(frozen=True)
class LiveState(JsonRecord):
    """What a worker does, also while no car drives.

    Attributes:
        worker: "sim-0", "sim-1", ..., "evaluation".
        pid: Its process.
        activity: What it does or waits for, in a few words.
        waits: Whether it waits for another worker.
        since_s: Unix time since when it does that.
        iteration: What it drives or drove last; None in an evaluation, and before the first.
        checkpoint: With which checkpoint; empty before the first.
        hint: Why a view cannot be shown now, a sentence; empty if all can.
    """

    worker: str
    pid: int
    activity: str
    waits: bool
    since_s: float
    iteration: int | None = None
    checkpoint: str = ""
    hint: str = ""


@dataclass(frozen=True)
class LiveRacer:
    """Who drives.

    Attributes:
        model: Its prefix or file.
        color: As DR_CAR_COLOR.
        rgb: The same as red, green and blue, 0 to 255.
    """

    model: str
    color: str
    rgb: tuple[int, ...] = ()


@dataclass(frozen=True)
class LiveCar:
    """A car after a step.

    Attributes:
        car: Its number in the worker, from 0.
        racer: Index of its racer in `LiveScene.racers`.
        episode: Number of its episode.
        phase: "training" or "evaluation".
        reverse: Whether it drives against the direction of the scene.
        x: World x of the point 0.14 m ahead of the car's origin, as in traces, metres.
        y: World y of that point.
        yaw_deg: Heading.
        speed_mps: How fast it is.
        asked_mps: The speed that its policy asked for.
        steering_deg: The steering that its policy asked for, left positive.
        progress: Percent of the lap.
        reward: Of this step.
        total: Reward of the episode so far.
        status: A status of traces, such as `in_progress`.
        steps: Of the episode so far.
        lap_s: Simulated seconds since its lap began.
        laps: Laps completed in the episode.
        resets: Violations forgiven in the episode.
    """

    car: int
    racer: int
    episode: int
    phase: str
    reverse: bool
    x: float
    y: float
    yaw_deg: float
    speed_mps: float
    asked_mps: float
    steering_deg: float
    progress: float
    reward: float
    total: float
    status: str
    steps: int
    lap_s: float
    laps: int = 0
    resets: int = 0


@dataclass(frozen=True)
class LiveObject:
    """An obstacle, a bot or another racer.

    Attributes:
        kind: Name of its shape, such as `box_obstacle`, `bot_car`, `race_car`.
        x: Of its middle on the floor, metres.
        y: Of the same point.
        yaw_deg: Heading.
    """

    kind: str
    x: float
    y: float
    yaw_deg: float


@dataclass(frozen=True)
class ShownCar:
    """More about the car that a viewer looks at.

    Attributes:
        car: Its number.
        objects: What stands and drives around it. Every car has objects of its own.
        probabilities: Of each action, in the order of `LiveScene.actions`; None for continuous
            actions, and where the engine does not tell.
        chosen: Index of the action; None for continuous actions.
        mean: Of continuous actions: the most likely steering in degrees and speed in m/s.
        low: What 16 % of the draws are below.
        high: What 84 % are below.
        value: Reward that the critic expects from here on, discounted; None without a critic.
        lidar: What the lidar gives to the policy; empty without one.
    """

    car: int
    objects: list[LiveObject] = field(default_factory=list)
    probabilities: list[float] | None = None
    chosen: int | None = None
    mean: list[float] | None = None
    low: list[float] | None = None
    high: list[float] | None = None
    value: float | None = None
    lidar: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class FinishedEpisode:
    """An episode that has ended, or a lap of a race of several laps.

    Attributes:
        serial: Counts the episodes of the worker process, from 1. A viewer that misses scenes still
            sees which ones are new.
        episode: Its number.
        phase: "training" or "evaluation".
        racer: Index of its racer.
        world: Its track.
        iteration: In which it was driven; None in an evaluation.
        checkpoint: With which checkpoint.
        status: How it ended.
        lap: Which lap of its episode it was, from 1. A race of several laps counts lap by lap.
        progress: Percent of the lap at its end.
        time_s: Simulated seconds; the lap time, if one lap was completed.
        reward: Its sum.
        steps: How many.
        ended_s: Unix time of its end.
        resets: How often the car was put back on the track.
    """

    serial: int
    episode: int
    phase: str
    racer: int
    world: str
    iteration: int | None
    checkpoint: str
    status: str
    lap: int
    progress: float
    time_s: float
    reward: float
    steps: int
    ended_s: float
    resets: int = 0


@dataclass(frozen=True)
class LiveScene(JsonRecord):
    """All cars of a worker after a step.

    Attributes:
        world: The track.
        reverse: Whether it is driven against the direction of its definition.
        race_type: As DR_RACE_TYPE.
        iteration: None in an evaluation.
        checkpoint: What drives.
        racers: Who drives; more than one in a race.
        actions: Steering in degrees and speed in m/s of discrete actions; empty for continuous
            ones.
        cars: Those that drive, by number.
        shown: The car that this viewer looks at; None if that one does not drive.
        finished: The newest episodes that have ended, oldest first.
    """

    world: str
    reverse: bool
    race_type: str
    iteration: int | None
    checkpoint: str
    racers: list[LiveRacer]
    actions: list[list[float]]
    cars: list[LiveCar]
    shown: ShownCar | None
    finished: list[FinishedEpisode] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """The scene as a JSON object, without the copies of `asdict`: it is made often."""
        return {**vars(self)}

    def encode(self) -> bytes:
        """The scene as JSON text."""
        return json.dumps(self.to_json(), default=vars, allow_nan=False).encode()
