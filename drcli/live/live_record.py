"""What a simulation worker shows to viewers on this machine.

The worker writes its `LiveAddress`; a viewer sends a `LiveRequest` and gets `LiveMessage`s.
"""

import hashlib
import hmac
import json
import os
import secrets
import socket
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

from msgspec import Meta

from drcli.base.files import load_record, write_private_json
from drcli.base.framing import WireError, exactly, framed
from drcli.base.json_record import JsonRecord, Pid, RecordError, SafeInt, Seconds, decode_json
from drcli.base.processes import is_alive, started_s

LiveView = Literal["camera", "chase", "scene", "state"]
"""What a car sees, the view from behind, all cars; everyone gets the state."""

LIVE_VIEWS: tuple[LiveView, ...] = get_args(LiveView)

PROTOCOL = 1
LIVE_FILES = "live-*.json"

MOST_CAR = 1 << 20

_HEADER_BYTES = 2


def live_file(folder: Path, name: str) -> Path:
    return folder / LIVE_FILES.replace("*", name)


@dataclass(frozen=True)
class LiveAddress:
    """Where a worker listens, in a file that only this user can read.

    Attributes:
        port: On 127.0.0.1.
        key: 64 hexadecimal digits that both sides prove to know; never sent.
        pid_started: From `process_identity.started_s`; process numbers are reused.
    """

    port: SafeInt
    key: str
    pid: Pid
    pid_started: Seconds
    protocol: SafeInt = PROTOCOL

    @staticmethod
    def own(port: int) -> "LiveAddress":
        pid = os.getpid()
        return LiveAddress(port, secrets.token_hex(32), pid, started_s(pid) or 0.0)

    @property
    def secret(self) -> bytes:
        return self.key.encode("ascii", "replace")

    @property
    def is_usable(self) -> bool:
        return (
            self.protocol == PROTOCOL
            and 0 < self.port < 1 << 16
            and len(self.key) >= 32
            and is_alive(self.pid, self.pid_started)
        )

    def write(self, folder: Path, name: str) -> None:
        write_private_json(live_file(folder, name), asdict(self))

    def delete(self, folder: Path, name: str) -> None:
        if LiveAddress.read(live_file(folder, name)) == self:
            with suppress(OSError):
                live_file(folder, name).unlink(missing_ok=True)

    @staticmethod
    def read(path: Path) -> "LiveAddress | None":
        return load_record(LiveAddress, path)


@dataclass(frozen=True)
class LiveRequest(JsonRecord):
    """`car` counts from 0; None: the one furthest ahead."""

    views: tuple[LiveView, ...] = ()
    car: Annotated[int, Meta(ge=0, lt=MOST_CAR)] | None = None


@dataclass(frozen=True)
class LiveMessage:
    """`step_s` is Unix time; `data` is JPEG, or JSON of a `LiveScene` or `LiveState`."""

    view: LiveView
    step_s: Seconds
    data: bytes = b""
    car: SafeInt | None = None
    width: SafeInt = 0
    height: SafeInt = 0

    def encode(self) -> bytes:
        """Length of the header in two bytes, header as JSON, data."""
        header = {"view": self.view, "step_s": self.step_s}
        if self.car is not None:
            header["car"] = self.car
        if self.width:
            header |= {"width": self.width, "height": self.height}
        text = json.dumps(header, allow_nan=False).encode()
        return len(text).to_bytes(_HEADER_BYTES, "big") + text + self.data

    @staticmethod
    def decode(data: bytes) -> "LiveMessage":
        begin = _HEADER_BYTES + int.from_bytes(data[:_HEADER_BYTES], "big")
        if len(data) < begin:
            raise RecordError("it ends too early")
        return replace(decode_json(LiveMessage, data[_HEADER_BYTES:begin]), data=data[begin:])

    @property
    def scene(self) -> "LiveScene":
        return LiveScene.decode(self.data)

    @property
    def state(self) -> "LiveState":
        return LiveState.decode(self.data)


@dataclass(frozen=True)
class LiveState(JsonRecord):
    """What a worker does, also while no car drives.

    Attributes:
        waits: For another worker.
        since_s: Unix time.
        hint: Why a view cannot be shown now.
    """

    worker: str
    pid: Pid
    activity: str
    waits: bool
    since_s: Seconds
    iteration: SafeInt | None = None
    checkpoint: str = ""
    hint: str = ""


@dataclass(frozen=True)
class LiveRacer:
    model: str
    color: str
    rgb: tuple[SafeInt, ...] = ()


@dataclass(frozen=True)
class LiveCar:
    """A car after a step.

    Attributes:
        reverse: Against the scene's direction.
        x: Of the point 0.14 m ahead of the origin, metres; so is `y`.
        asked_mps: Requested.
        steering_deg: Requested, left positive.
        reward: Of this step.
        total: Of the episode.
        status: As in traces.
        lap_s: Simulated seconds of its lap.
        resets: Violations forgiven.
        world: Its track, where that may be another than the scene's.
    """

    car: SafeInt
    racer: SafeInt
    episode: SafeInt
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
    steps: SafeInt
    lap_s: Seconds
    laps: SafeInt = 0
    resets: SafeInt = 0
    world: str = ""


@dataclass(frozen=True)
class LiveObject:
    kind: str
    x: float
    y: float
    yaw_deg: float


@dataclass(frozen=True)
class ShownCar:
    """More about the car that a viewer looks at.

    Attributes:
        objects: Around it; each car has its own.
        probabilities: Of `LiveScene.actions`; None if continuous.
        mean: Likeliest continuous action, degrees and m/s.
        low: 16 % quantile.
        high: 84 % quantile.
        value: Discounted reward that the critic expects.
    """

    car: SafeInt
    objects: list[LiveObject] = field(default_factory=list)
    probabilities: list[float] | None = None
    chosen: SafeInt | None = None
    mean: list[float] | None = None
    low: list[float] | None = None
    high: list[float] | None = None
    value: float | None = None
    lidar: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class FinishedEpisode:
    """An episode that has ended, or a lap of a race of several laps.

    Attributes:
        serial: Shows a viewer that misses scenes which ones are new.
        time_s: Simulated seconds.
        ended_s: Unix time.
    """

    serial: SafeInt
    episode: SafeInt
    phase: str
    racer: SafeInt
    world: str
    iteration: SafeInt | None
    checkpoint: str
    status: str
    lap: SafeInt
    progress: float
    time_s: Seconds
    reward: float
    steps: SafeInt
    ended_s: Seconds
    resets: SafeInt = 0


@dataclass(frozen=True)
class LiveScene(JsonRecord):
    """All cars of a worker after a step.

    Attributes:
        actions: Discrete, degrees and m/s.
        shown: None if it does not drive.
        finished: Newest episodes.
    """

    world: str
    reverse: bool
    race_type: str
    iteration: SafeInt | None
    checkpoint: str
    racers: list[LiveRacer]
    actions: list[list[float]]
    cars: list[LiveCar]
    shown: ShownCar | None
    finished: list[FinishedEpisode] = field(default_factory=list)

    def encode(self) -> bytes:
        """Without `asdict`'s copies: it is made often."""
        return json.dumps(vars(self), default=vars, allow_nan=False).encode()


# How live pictures travel between a worker and a viewer: proof of the key, then messages.
#
# Not `multiprocessing.connection`: its listener waits forever for a silent visitor, its sender
# for a reader that does not read. Nothing is unpickled.


HOST = "127.0.0.1"

MOST_MESSAGE_BYTES = 4 << 20
MOST_REQUEST_BYTES = 4096
_GREETING = b"drcli-live-%d\n" % PROTOCOL
_NONCE_BYTES = 32


def admit(peer: socket.socket, key: bytes) -> None:
    """Let a viewer in that knows the key, and prove to know it too.

    Raises:
        WireError: It does not know it.
        OSError: It left or timed out.
    """
    own = secrets.token_bytes(_NONCE_BYTES)
    peer.sendall(_GREETING + own)
    theirs = exactly(peer, _NONCE_BYTES)
    if not hmac.compare_digest(exactly(peer, _NONCE_BYTES), _proof(key, b"viewer", own, theirs)):
        raise WireError("the viewer does not know the key")
    peer.sendall(_proof(key, b"worker", own, theirs))


def enter(peer: socket.socket, key: bytes) -> None:
    """Check that a worker knows the key, and prove to know it too.

    Raises:
        WireError: It is another program, or refuses the key.
        OSError: It left or timed out.
    """
    if exactly(peer, len(_GREETING)) != _GREETING:
        raise WireError("another program listens there")
    theirs = exactly(peer, _NONCE_BYTES)
    own = secrets.token_bytes(_NONCE_BYTES)
    peer.sendall(own + _proof(key, b"viewer", theirs, own))
    if not hmac.compare_digest(exactly(peer, _NONCE_BYTES), _proof(key, b"worker", theirs, own)):
        raise WireError("the worker does not know the key")


def send(peer: socket.socket, data: bytes) -> None:
    """OSError if the other side left or does not read in time."""
    peer.sendall(framed(data))


def _proof(key: bytes, side: bytes, of_worker: bytes, of_viewer: bytes) -> bytes:
    """Depends on both random numbers, so it cannot be reused."""
    return hmac.digest(key, side + of_worker + of_viewer, hashlib.sha256)
