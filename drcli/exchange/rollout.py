"""The format of a rollout: driven episodes as bytes, and back.

A rollout is a safetensors file with a tensor for each column. Camera frames are zstd level 1
without any prediction. Measured on one core: frames of the computed camera, whose ground has a
grain, shrink to 38 % at 160 MB/s and unpack at 400 MB/s. On the way through the local bucket and
back this takes a fifth more processor time than plain bytes would; through any other bucket, a
third of the bytes is worth that.
"""

import contextlib
import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from drcli.base.json_record import Misfit
from drcli.learn.rollout_buffer import Rollout

SCHEMA = "2"
"""Raised when a reader of the old form would misread the new one."""

_ZSTD_LEVEL = 1

_OF_STEPS = {
    "actions": "actions",
    "log_probs": "log_probs",
    "values": "values",
    "rewards": "rewards",
    "scans": "extra.scans",
    "states": "extra.states",
}
"""Columns of a rollout with a row for each step, and their names in the file."""

_OF_EPISODES = {
    "lengths": "episode_lengths",
    "last_values": "extra.last_values",
    "cut": "extra.cut",
}
"""Columns of a rollout with a row for each episode, and their names in the file."""

_OF_OUTCOMES = {
    "numbers": "episode_numbers",
    "progress": "extra.progress",
    "completed": "extra.completed",
    "duration_s": "extra.duration_s",
}
"""Columns beside the rollout with a row for each episode, and their names in the file."""

_TYPES = {
    **dict.fromkeys(("log_probs", "scans", "states"), np.float32),
    **dict.fromkeys(("values", "rewards", "last_values", "progress", "duration_s"), np.float64),
    **dict.fromkeys(("lengths", "numbers"), np.int64),
    **dict.fromkeys(("cut", "completed"), np.bool_),
}

LARGEST_FRAMES_BYTES = 1 << 20
"""What the frames of one step take at most. Two cameras of 160 x 120 take 38,400."""

_LARGEST_HEADER_BYTES = 1 << 20


@dataclass(frozen=True)
class Episodes:
    """Whole episodes, one after the other: what the learner takes, and how each of them ended.

    Args:
        rollout: T steps in E episodes.
        numbers: Which episodes these are. Shape (E,).
        progress: Percent of the lap at the end of each. Shape (E,).
        completed: Which ended with a completed lap. Shape (E,).
        duration_s: Simulated seconds of each. Shape (E,).

    Raises:
        ValueError: Lengths or types do not fit.
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
        for names, rows, what in (
            (_OF_STEPS, steps, "frames"),
            (_OF_EPISODES, count, "episodes"),
            (_OF_OUTCOMES, count, "episodes"),
        ):
            for name in names:
                column = self._column(name)
                if len(column) != rows:
                    raise ValueError(f"{name} has {len(column)} rows for {rows} {what}")
                if column.dtype != _TYPES.get(name, column.dtype):
                    raise ValueError(f"{name} is {_TYPES[name].__name__}, not {column.dtype}")
        if int(self.rollout.lengths.sum()) != steps:
            raise ValueError(f"episodes of {self.rollout.lengths.sum()} steps, {steps} frames")

    def _column(self, name: str) -> NDArray[Any]:
        column: NDArray[Any] = getattr(self if name in _OF_OUTCOMES else self.rollout, name)
        return column

    @property
    def steps(self) -> int:
        """Number of steps of all episodes together."""
        return self.rollout.steps

    @property
    def count(self) -> int:
        """Number of episodes."""
        return len(self.numbers)

    def chosen(self, which: NDArray[np.int64]) -> "Episodes":
        """Some of the episodes; this copies their frames.

        Args:
            which: Indices of episodes. Shape (k,).
        """
        ends = np.cumsum(self.rollout.lengths)
        begins = ends - self.rollout.lengths
        rows = np.concatenate([np.arange(begins[i], ends[i]) for i in which])
        columns = {name: self._column(name)[rows] for name in ("frames", *_OF_STEPS)}
        columns |= {name: self._column(name)[which] for name in (*_OF_EPISODES, *_OF_OUTCOMES)}
        return _episodes(columns)


def encode_episodes(episodes: Episodes) -> bytes:
    """Episodes as bytes; the arrays may be used again afterwards."""
    frames = np.ascontiguousarray(episodes.rollout.frames)
    packed = zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(frames.data.cast("B"))
    tensors = {"frames": np.frombuffer(packed, np.uint8)}
    for name, key in {**_OF_STEPS, **_OF_EPISODES, **_OF_OUTCOMES}.items():
        tensors[key] = np.ascontiguousarray(episodes._column(name))
    header = {"schema": SCHEMA, "frames_shape": json.dumps(frames.shape), "notes": "{}"}
    return bytes(save(tensors, metadata=header))


def decode_episodes(parts: Iterable[bytes], steps: int) -> Episodes:
    """The episodes of several objects, one after the other.

    Frames are by far the most of it. They unpack straight into their place in one array, object by
    object, so that only one of these needs to be in memory at a time.

    Args:
        parts: What `encode_episodes` gave, at least one.
        steps: Of all of them together.

    Raises:
        Misfit: One of the objects is something else, or not like the first, or there are more or
            fewer steps.
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
    outcomes = {name: columns.pop(name) for name in _OF_OUTCOMES}
    return Episodes(Rollout(**columns), **outcomes)


@dataclass(frozen=True)
class _Packed:
    """An object whose frames are still compressed."""

    columns: dict[str, NDArray[Any]]
    frames: NDArray[np.uint8]
    frames_shape: tuple[int, ...]

    @staticmethod
    def of(data: bytes) -> "_Packed":
        header = _header(data)
        if header.get("schema") != SCHEMA:
            raise ValueError(f"schema {header.get('schema')} instead of {SCHEMA}")
        tensors = load(data)
        columns = {}
        for name, key in {**_OF_STEPS, **_OF_EPISODES, **_OF_OUTCOMES}.items():
            column = tensors[key]
            if _TYPES.get(name) is np.float64:  # float32 in rollouts of version 0.1.0
                column = column.astype(np.float64, copy=False)
            columns[name] = column
        frames_shape = _checked_shape(json.loads(header["frames_shape"]))
        found = _Packed(columns, tensors["frames"], frames_shape)
        found.refuse_false_claims()
        return found

    def refuse_false_claims(self) -> None:
        """Compare what the header claims with the bytes that are there, before room is made.

        Raises:
            ValueError: They differ.
        """
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
        reader = zstandard.ZstdDecompressor().stream_reader(self.frames.data)
        if reader.readinto(room.data.cast("B")) != room.nbytes or reader.read(1):
            raise ValueError("more or fewer frames than it says")


@contextlib.contextmanager
def _explained() -> Iterator[None]:
    """Say of whatever goes wrong with an object that it is something else."""
    try:
        yield
    except (
        *(AttributeError, IndexError, KeyError, TypeError, ValueError),
        *(MemoryError, OverflowError, RecursionError),
        *(SafetensorError, zstandard.ZstdError),
    ) as e:
        what = f"{e} is missing" if isinstance(e, KeyError) else str(e)
        raise Misfit(f"it does not hold episodes ({what})") from e


def _header(data: bytes) -> dict[str, str]:
    """The text entries of a safetensors file, which its loader keeps to itself."""
    length = int.from_bytes(data[:8], "little")
    if length > min(len(data) - 8, _LARGEST_HEADER_BYTES):
        raise ValueError(f"its header claims {length} bytes")
    header = json.loads(data[8 : 8 + length])
    found: dict[str, str] = header["__metadata__"]
    return found


def _checked_shape(value: Any) -> tuple[int, ...]:
    """The shape of frames, none of them larger than frames are."""
    if not isinstance(value, list) or len(value) != 4:
        raise ValueError("its frames have no shape (steps, eyes, height, width)")
    if not all(isinstance(size, int) and 0 < size < 2**31 for size in value):
        raise ValueError(f"frames cannot have the shape {value}")
    if math.prod(value[1:]) > LARGEST_FRAMES_BYTES:
        raise ValueError(f"frames of {value[1:]} are too large")
    return tuple(value)


def _shape(array: NDArray[Any]) -> str:
    return f"{array.shape} {array.dtype}"
