"""Lets viewers on this machine connect to a worker.

Each viewer has two threads. A slow viewer sees less, and nobody waits for it.
"""

import io
import math
import socket
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache
from time import monotonic, process_time, thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drcli.base.framing import WireError, framed, receive
from drcli.base.installation import lazy_imports
from drcli.base.json_record import RecordError
from drcli.base.log import get_logger
from drcli.live.live_record import HOST, MOST_REQUEST_BYTES, LiveRequest, LiveView, admit
from drcli.live.step_snapshot import Rider, StepSnapshot
from drsim.race.solids import SHAPES
from drsim.track.track import Track
from drsim.viewing.car_eye import FollowingCamera
from drsim.viewing.placed_objects import PlacedObject
from drsim.viewing.world_view import WorldView

with lazy_imports():
    from PIL import Image, ImageDraw

MOST_VIEWERS = 8
GREETING_S = 3.0
"""To prove the key, and to say what it wants."""

SILENCE_S = 10.0
"""Viewers repeat their request more often."""

SIGN_OF_LIFE_S = 2.0
"""Then a viewer gets the state once more."""

REQUEST_PAUSE_S = 0.02
BUFFER_BYTES = 1 << 16
"""In the kernel: pictures must not become old there."""


class Viewer:
    def __init__(self, peer: socket.socket, request: LiveRequest) -> None:
        self.request = request
        self.is_new = True
        self._peer = peer
        self._direct = peer.dup()
        self._direct.setblocking(False)
        self._waiting: dict[LiveView, bytes] = {}
        self._rest = b""
        self._state: bytes | None = None
        self._changed = threading.Condition()
        self._writes = False
        self._closed = False
        self._sent_s = monotonic()
        self._spent_s = self._told_s = 0.0

    def cost_s(self) -> float:
        """Processor time of its own thread since the last call."""
        before_s, self._told_s = self._told_s, self._spent_s
        return self._told_s - before_s

    def offer(self, messages: Mapping[LiveView, bytes]) -> None:
        """Returns at once.

        The caller sends what the connection takes: waking a thread costs more than the rest of
        a picture.
        """
        with self._changed:
            if self._closed:
                return
            self._waiting |= messages
            self._state = messages.get("state", self._state)
            if not self._writes:
                self._send_now()
            if self._waiting or self._rest:
                self._changed.notify()

    def _send_now(self) -> None:
        while self._waiting and not self._rest:
            view = next(iter(self._waiting))
            data = framed(self._waiting[view])
            try:
                count = self._direct.send(data)
            except BlockingIOError:
                return
            except OSError:  # it left; the thread that reads from it notices that, too
                self._waiting.clear()
                return
            del self._waiting[view]
            self._rest = data[count:]
            self._sent_s = monotonic()

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._direct.close()
            self._changed.notify()
        with suppress(OSError):
            self._peer.shutdown(socket.SHUT_RDWR)

    def write(self) -> None:
        try:
            while not self._closed:
                data = self._taken()
                if data:
                    self._peer.sendall(data)
                    self._sent_s = monotonic()
                self._spent_s = thread_time()
        except OSError:
            self.close()

    def _taken(self) -> bytes:
        with self._changed:
            self._writes = False
            if not (self._rest or self._waiting or self._closed):
                self._changed.wait(SIGN_OF_LIFE_S)
            rest, waiting = self._rest, self._waiting
            self._rest, self._waiting = b"", {}
            if not (rest or waiting) and self._state is not None:
                if monotonic() - self._sent_s < SIGN_OF_LIFE_S:
                    return b""
                waiting = {"state": self._state}
            self._writes = True
            return rest + b"".join(map(framed, waiting.values()))


class LiveServer:
    def __init__(self, key: bytes, on_change: Callable[[], None]) -> None:
        """Begin to listen; OSError if this machine does not allow it.

        `on_change` is called from another thread when a viewer came, went or wants something
        else.
        """
        self._key = key
        self._on_change = on_change
        self._lock = threading.Lock()
        self._visitors = 0
        self._closed = threading.Event()
        self.viewers: tuple[Viewer, ...] = ()
        """Those who watch now; replaced as a whole."""
        self._listener = socket.create_server((HOST, 0), backlog=MOST_VIEWERS)
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, name="live-accept", daemon=True).start()

    def close(self) -> None:
        self._closed.set()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for viewer in self.viewers:
            viewer.close()

    def _accept(self) -> None:
        while not self._closed.is_set():
            try:
                peer, _ = self._listener.accept()
            except OSError:  # too many open files, or this server was closed
                self._closed.wait(1.0)
                continue
            with self._lock:
                has_room = self._visitors < MOST_VIEWERS and not self._closed.is_set()
                self._visitors += has_room
            if not has_room or not self._start(self._receive, peer):
                peer.close()

    def _start(self, target: Callable[[socket.socket], None], peer: socket.socket) -> bool:
        try:
            threading.Thread(target=target, args=(peer,), name="live-viewer", daemon=True).start()
        except RuntimeError:  # no more threads; the visitor may try again
            with self._lock:
                self._visitors -= 1
            return False
        return True

    def _receive(self, peer: socket.socket) -> None:
        viewer = None
        try:
            peer.settimeout(GREETING_S)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
            admit(peer, self._key)
            request = LiveRequest.decode(receive(peer, MOST_REQUEST_BYTES))
            viewer = Viewer(peer, request)
            peer.settimeout(SILENCE_S)
            threading.Thread(target=viewer.write, name="live-sender", daemon=True).start()
            with self._lock:
                self.viewers = (*self.viewers, viewer)
            while not self._closed.is_set():
                self._on_change()
                while request == viewer.request:
                    self._closed.wait(REQUEST_PAUSE_S)
                    request = LiveRequest.decode(receive(peer, MOST_REQUEST_BYTES))
                viewer.request = request
        except (OSError, WireError, RecordError, RuntimeError):
            pass  # it left, or is none of ours
        finally:
            if viewer is not None:
                viewer.close()
            peer.close()
            with self._lock:
                self.viewers = tuple(each for each in self.viewers if each is not viewer)
                self._visitors -= 1
            self._on_change()


# How often a worker shows what it drives: as its time budget allows.


BUDGET_SHARE = 0.01
"""Of a worker's processor time. Its threads also disturb others; together at most 1.5 %."""

SAVED_S = 20.0
"""Of unused budget: while the trainer learns, there is nothing to show."""

FASTEST_S = 0.1
SLOWEST_S: Mapping[LiveView, float] = {"camera": 5.0, "scene": 5.0, "chase": 60.0}
_FULL_SPEED: Mapping[LiveView, float] = {"camera": 0.03, "scene": 0.1, "chase": 1.0}
"""How full the account must be for the fastest rate. The view from behind costs most and becomes
rarer first; the camera, which people look at longest, does so last.
"""


class WorkTime:
    """Seconds of a worker's time, of which a live view may use a share.

    Wall time while it waits; else processor time, at most wall time: on a busy machine, a
    second of it delays by longer.
    """

    def __init__(self, waits: Callable[[], bool]) -> None:
        self._waits = waits
        self._total_s = 0.0
        self._wall_s, self._processor_s = monotonic(), process_time()

    def __call__(self) -> float:
        wall_s, processor_s = monotonic(), process_time()
        passed_s, used_s = wall_s - self._wall_s, processor_s - self._processor_s
        self._wall_s, self._processor_s = wall_s, processor_s
        self._total_s += passed_s if self._waits() else min(passed_s, used_s)
        return self._total_s


class Pace:
    """An account of processor time that fills steadily, and rates that follow it."""

    def __init__(
        self, worked_s: Callable[[], float], clock: Callable[[], float] = monotonic
    ) -> None:
        self._worked_s = worked_s
        self._clock = clock
        self._most_s = BUDGET_SHARE * SAVED_S
        self._left_s = self._most_s
        self._counted_s = worked_s()
        self._shown_s: dict[LiveView, float] = {}

    def spend(self, cost_s: float) -> None:
        self._left_s = max(-self._most_s, self._left_s - cost_s)

    def shown(self, views: Iterable[LiveView]) -> None:
        self._shown_s |= dict.fromkeys(views, self._clock())

    def pauses_s(self, views: Iterable[LiveView]) -> dict[LiveView, float]:
        """0 if a view may be shown now."""
        now_s, worked_s = self._clock(), self._worked_s()
        earned_s = BUDGET_SHARE * (worked_s - self._counted_s)
        self._left_s = min(self._most_s, self._left_s + earned_s)
        self._counted_s = worked_s
        return {
            view: max(0.0, self._shown_s[view] + self.interval_s(view) - now_s)
            if view in self._shown_s
            else 0.0
            for view in views
        }

    def interval_s(self, view: LiveView) -> float:
        filled = self._left_s / self._most_s / _FULL_SPEED[view]
        if filled <= FASTEST_S / SLOWEST_S[view]:
            return SLOWEST_S[view]
        return FASTEST_S / min(1.0, filled)


# Pictures of a worker: what a car sees, and the view from behind it.


_logger = get_logger(__name__)

Rgb = tuple[float, float, float]

CAMERA_SIZE = (160, 120)
"""Columns and rows."""

NO_CAMERA = "The teacher\nsees the track,\nno camera."
CHASE_SIZE = (320, 240)
MOST_WORLDS = 2
"""Painted, up to 70 MB each: the track, and that of other evaluations."""

_QUALITY = 75
_WHEELS_RAD = math.radians(30.0)
_NOWHERE = (0.0, 0.0, 0.0)


def missing_library() -> str:
    """Why there can be no pictures; empty if there can."""
    try:
        import PIL.Image  # noqa: F401  whether it is there
    except ImportError as error:
        return f"Pictures need the package pillow, which cannot be loaded here ({error})."
    return ""


def jpeg(picture: NDArray[np.uint8]) -> bytes:
    """Grey (rows, columns) or RGB (rows, columns, 3)."""
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=_QUALITY)
    return file.getvalue()


def camera_picture(frames: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A car's eyes, shape (eyes, rows, columns), side by side.

    A teacher has no pixels: the picture says so.
    """
    if not frames.size:
        return _words(NO_CAMERA)
    return np.ascontiguousarray(np.concatenate(list(frames), axis=1))


@cache
def _words(text: str) -> NDArray[np.uint8]:
    columns, rows = CAMERA_SIZE
    picture = Image.new("L", CAMERA_SIZE, 40)
    draw = ImageDraw.Draw(picture)
    draw.multiline_text((columns // 2, rows // 2), text, 230, anchor="mm", align="center")
    return np.asarray(picture)


class ChaseView:
    def __init__(self) -> None:
        self._worlds: dict[tuple[str, bool], WorldView] = {}
        self._painter: threading.Thread | None = None
        self._failed: set[tuple[str, bool]] = set()
        self._cameras: dict[int, tuple[FollowingCamera, int]] = {}

    @property
    def is_painting(self) -> bool:
        return self._painter is not None and self._painter.is_alive()

    @property
    def hint(self) -> str:
        if self.is_painting:
            return "The view from behind the car is being prepared."
        if self._failed:
            return "There is no view from behind the car; the log of the worker says why."
        return ""

    def is_ready(self, track: Track) -> bool:
        """Whether a track's world is painted; if not, a thread begins.

        That takes one to two seconds of processor time.
        """
        key = (track.name, track.reverse)
        if key in self._worlds:
            return True
        if not self.is_painting and key not in self._failed:
            self._painter = threading.Thread(
                target=self._paint, args=(key, track), name="live-painter", daemon=True
            )
            self._painter.start()
        return False

    def _paint(self, key: tuple[str, bool], track: Track) -> None:
        columns, rows = CHASE_SIZE
        try:
            world = WorldView(track, columns=columns, rows=rows, threads=1)
            # A first picture compiles the kernels here, where nobody waits for it.
            lens = FollowingCamera().lens(_NOWHERE, step_s=1.0 / 15.0)
            world.frame(lens, [PlacedObject(SHAPES["race_car"], _NOWHERE, (0.0, 0.0, 0.0), 0.0)])
        except Exception as error:  # such as no memory; the cars drive on
            self._failed.add(key)
            _logger.warning("There is no view from behind on %s.", track.name, exc_info=error)
            return
        while len(self._worlds) >= MOST_WORLDS:
            del self._worlds[next(iter(self._worlds))]
        self._worlds[key] = world

    def picture(self, moment: StepSnapshot, rider: Rider, colors: list[Rgb]) -> NDArray[np.uint8]:
        """Its world must be painted; colors from 0 to 255."""
        track, car = rider.track, rider.car
        key = (track.name, track.reverse)
        world = self._worlds[key]
        camera, last = self._cameras.setdefault(car, (FollowingCamera(), 0))
        steps = moment.result.steps.item(car)
        self._cameras[car] = camera, steps
        if steps < last:
            camera.cut()
        pose = _pose(moment.poses[car])
        lens = camera.lens(pose, step_s=max(1, steps - last) / 15.0)
        wheels = math.radians(moment.steering_deg.item(car))
        things = [
            PlacedObject(
                SHAPES["race_car"],
                pose,
                colors[rider.racer % len(colors)],
                min(max(wheels, -_WHEELS_RAD), _WHEELS_RAD),
                rolled_m=moment.result.progress.item(car) / 100.0 * track.length_m,
            )
        ]
        for shape, place in zip(moment.shapes, moment.objects[car], strict=True):
            other = shape.name == "race_car"
            color = colors[(rider.racer + 1) % len(colors)] if other else None
            things.append(PlacedObject(shape, _pose(place), color))
        return world.frame(lens, things)


def _pose(values: NDArray[Any]) -> tuple[float, float, float]:
    x, y, yaw = values.tolist()
    return x, y, yaw
