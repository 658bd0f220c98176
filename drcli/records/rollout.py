"""The format of a rollout: driven episodes as bytes, and back.

A safetensors file with a tensor for each column. Frames are zstd level 1: on one core, those of the
computed camera shrink to 38 % at 160 MB/s and unpack at 400 MB/s. With the local bucket this costs
a fifth more processor time than plain bytes.
"""

import contextlib
import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from drcli.base.json_record import Amount, Fingerprint, JsonRecord, RecordError, SafeInt
from drcli.learn.rollout_buffer import Rollout
from drcli.records.checkpoint import NameText

SCHEMA = "2"
"""Changes when old readers would misread the format."""

_ZSTD_LEVEL = 1

_STEP = {
    "actions": ("actions", None),
    "log_probs": ("log_probs", np.float32),
    "values": ("values", np.float64),
    "rewards": ("rewards", np.float64),
    "scans": ("extra.scans", np.float32),
    "states": ("extra.states", np.float32),
    "learned": ("extra.learned", np.bool_),
}
_EPISODE = {
    "lengths": ("episode_lengths", np.int64),
    "last_values": ("extra.last_values", np.float64),
    "cut": ("extra.cut", np.bool_),
    "numbers": ("episode_numbers", np.int64),
    "progress": ("extra.progress", np.float64),
    "completed": ("extra.completed", np.bool_),
    "duration_s": ("extra.duration_s", np.float64),
}
LARGEST_FRAMES_BYTES = 1 << 20
"""Of one step; two cameras take 38,400."""

_LARGEST_HEADER_BYTES = 1 << 20

_OUTCOMES = ("numbers", "progress", "completed", "duration_s")


@dataclass(frozen=True)
class Episodes:
    """T steps in E episodes, and how each ended.

    Arrays have the shape (E,); `progress` is percent, `duration_s` simulated.

    Raises:
        ValueError: Arrays do not fit.
    """

    rollout: Rollout
    numbers: NDArray[np.int64]
    progress: NDArray[np.float64]
    completed: NDArray[np.bool_]
    duration_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        frames, actions = self.rollout.frames, self.rollout.actions
        steps, count = len(frames), len(self.rollout.lengths)
        if not steps:
            raise ValueError("there is not a single step")
        if frames.dtype != np.uint8 or frames.ndim != 4:
            raise ValueError(f"frames are (T, eyes, height, width) uint8, not {_shape(frames)}")
        if actions.dtype not in (np.int64, np.float32):
            raise ValueError(f"actions are int64 or float32, not {actions.dtype}")
        for columns, rows, what in ((_STEP, steps, "frames"), (_EPISODE, count, "episodes")):
            for name, (_, kind) in columns.items():
                column = self.column(name)
                if len(column) != rows:
                    raise ValueError(f"{name} has {len(column)} rows for {rows} {what}")
                if kind is not None and column.dtype != kind:
                    raise ValueError(f"{name} is {kind.__name__}, not {column.dtype}")
        if int(self.rollout.lengths.sum()) != steps:
            raise ValueError(f"episodes of {self.rollout.lengths.sum()} steps, {steps} frames")

    def column(self, name: str) -> NDArray[Any]:
        column: NDArray[Any] = getattr(self if name in _OUTCOMES else self.rollout, name)
        return column

    @property
    def steps(self) -> int:
        return self.rollout.steps

    @property
    def count(self) -> int:
        return len(self.numbers)

    def chosen(self, which: NDArray[np.int64]) -> "Episodes":
        ends = np.cumsum(self.rollout.lengths)
        begins = ends - self.rollout.lengths
        rows = np.concatenate([np.arange(begins[i], ends[i]) for i in which])
        columns = {name: self.column(name)[rows] for name in ("frames", *_STEP)}
        columns |= {name: self.column(name)[which] for name in _EPISODE}
        return _episodes(columns)


def encode_episodes(episodes: Episodes) -> bytes:
    frames = np.ascontiguousarray(episodes.rollout.frames)
    plain = frames.data.cast("B") if frames.size else b""
    packed = zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(plain)
    tensors = {"frames": np.frombuffer(packed, np.uint8)}
    for name, (key, _) in (_STEP | _EPISODE).items():
        # safetensors writes the memory of any other array as it lies there.
        tensors[key] = np.ascontiguousarray(episodes.column(name))
    header = {"schema": SCHEMA, "frames_shape": json.dumps(frames.shape)}
    return bytes(save(tensors, metadata=header))


def decode_episodes(parts: Iterable[bytes], steps: int) -> Episodes:
    """The episodes of several objects, with so many `steps` together.

    Frames unpack into one array, so only one object is in memory.

    Raises:
        RecordError: An object is damaged or does not fit.
    """
    with _explained():
        frames = np.empty(0, np.uint8)
        columns: list[dict[str, NDArray[Any]]] = []
        begin = 0
        for data in parts:
            part = _Packed.of(data)
            if not columns:
                frames = np.empty((steps, *part.frames_shape[1:]), np.uint8)
            part.unpack_into(frames[begin : begin + part.steps])
            begin += part.steps
            columns.append(part.columns)
        if begin != steps or not columns:
            raise ValueError(f"{begin} steps instead of {steps}")
        return _episodes(
            {"frames": frames}
            | {name: np.concatenate([own[name] for own in columns]) for name in columns[0]}
        )


def _episodes(columns: dict[str, NDArray[Any]]) -> Episodes:
    outcomes = {name: columns.pop(name) for name in _OUTCOMES}
    return Episodes(Rollout(**columns), **outcomes)


@dataclass(frozen=True)
class _Packed:
    columns: dict[str, NDArray[Any]]
    frames: NDArray[np.uint8]
    frames_shape: tuple[int, ...]

    @staticmethod
    def of(data: bytes) -> "_Packed":
        header = _header(data)
        if header.get("schema") != SCHEMA:
            raise ValueError(f"schema {header.get('schema')} instead of {SCHEMA}")
        tensors = load(data)
        names = (_STEP | _EPISODE).items()
        columns = {n: tensors[key] for n, (key, _) in names if n != "learned" or key in tensors}
        for name in ("values", "rewards", "last_values"):  # float32 in rollouts of version 0.1.0
            columns[name] = columns[name].astype(np.float64, copy=False)
        frames_shape = _checked_shape(json.loads(header["frames_shape"]))
        found = _Packed(columns, tensors["frames"], frames_shape)
        found.refuse_false_claims()
        # Version 0.1.0 wrote no such column, and learned from all steps.
        columns.setdefault("learned", np.ones(found.steps, np.bool_))
        return found

    def refuse_false_claims(self) -> None:
        """ValueError if header and bytes differ, before memory is reserved."""
        rows = self.columns["rewards"].shape
        if rows != (self.steps,):
            raise ValueError(f"its header claims {self.steps} steps, its rewards are {rows}")
        if self.frames.dtype != np.uint8 or self.frames.ndim != 1:
            raise ValueError(f"its compressed frames are {_shape(self.frames)}")
        claimed = zstandard.get_frame_parameters(self.frames.data).content_size
        wanted = math.prod(self.frames_shape)
        if claimed != wanted:
            raise ValueError(f"its frames unpack to {claimed} bytes instead of {wanted}")

    @property
    def steps(self) -> int:
        return self.frames_shape[0]

    def unpack_into(self, room: NDArray[np.uint8]) -> None:
        if self.frames_shape != room.shape:
            raise ValueError(f"frames of shape {self.frames_shape} instead of {room.shape}")
        if not room.size:
            return
        reader = zstandard.ZstdDecompressor().stream_reader(self.frames.data)
        if reader.readinto(room.data.cast("B")) != room.nbytes or reader.read(1):
            raise ValueError("more or fewer frames than it says")


@contextlib.contextmanager
def _explained() -> Iterator[None]:
    try:
        yield
    except (
        *(AttributeError, IndexError, KeyError, TypeError, ValueError),
        *(MemoryError, OverflowError, RecursionError),
        *(SafetensorError, zstandard.ZstdError),
    ) as e:
        what = f"{e} is missing" if isinstance(e, KeyError) else str(e)
        raise RecordError(f"it does not contain episodes ({what})") from e


def _header(data: bytes) -> dict[str, str]:
    length = int.from_bytes(data[:8], "little")
    if length > min(len(data) - 8, _LARGEST_HEADER_BYTES):
        raise ValueError(f"its header claims {length} bytes")
    header = json.loads(data[8 : 8 + length])
    found: dict[str, str] = header["__metadata__"]
    return found


def _checked_shape(value: Any) -> tuple[int, ...]:
    if not isinstance(value, list) or len(value) != 4:
        raise ValueError("its frames have no shape (steps, eyes, height, width)")
    # Nothing is drawn for a teacher, so its frames have no pixels.
    if not all(isinstance(size, int) and 0 <= size < 2**31 for size in value):
        raise ValueError(f"frames cannot have the shape {value}")
    if math.prod(value[1:]) > LARGEST_FRAMES_BYTES:
        raise ValueError(f"frames of {value[1:]} are too large")
    return tuple(value)


def _shape(array: NDArray[Any]) -> str:
    return f"{array.shape} {array.dtype}"


# The manifest of a rollout: what one worker drove, and its objects.


LEAST_STEP_BYTES = 16
"""Action, log-probability, value, reward in 0.1.0."""


@dataclass(frozen=True)
class Part:
    key: str
    fingerprint: Fingerprint
    episodes: SafeInt
    steps: SafeInt

    def __post_init__(self) -> None:
        """Refuse claims beyond the bytes, before memory is reserved."""
        if not 0 < self.episodes <= self.steps <= self.fingerprint.size_bytes / LEAST_STEP_BYTES:
            raise RecordError(
                f"{self.fingerprint.size_bytes} bytes cannot hold {self.episodes} episodes of "
                f"{self.steps} steps"
            )


@dataclass(frozen=True)
class Driving:
    drive_s: Amount = 0.0
    evaluates: SafeInt | None = None
    reward_errors: SafeInt = 0
    discarded: SafeInt = 0


@dataclass(frozen=True)
class Manifest(JsonRecord):
    """What one worker drove; `rollbacks` happened before its checkpoint."""

    iteration: SafeInt
    worker: SafeInt
    checkpoint: NameText
    session: str
    parts: tuple[Part, ...] = ()
    notes: Driving = field(default_factory=Driving)
    rollbacks: SafeInt = 0

    @property
    def steps(self) -> int:
        return sum(part.steps for part in self.parts)

    def is_of(self, session: str) -> bool:
        return belongs(self.session, session)


def session_of_worker(start: str, process: int, drive: int) -> str:
    return f"{start}-{process}-{drive}"


def belongs(worker_session: str, start: str) -> bool:
    return worker_session == start or worker_session.startswith(f"{start}-")
