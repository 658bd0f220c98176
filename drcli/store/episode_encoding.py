"""A batch of played episodes as bytes: columns in a safetensors file, camera frames compressed.

Frames are zstd level 1 without any prediction. Measured on one core: frames of the computed camera,
whose ground has a grain, shrink to 38 % at 160 MB/s and unfold at 400 MB/s. On the way through the
local bucket and back this takes a fifth more processor time than plain bytes would; through any
other bucket, a third of the bytes is worth that.
"""

import contextlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from drcli.store.bucket import ObjectDamaged

SCHEMA = "2"
"""Raised when a reader of the old form would misread the new one."""

_LEVEL = 1
_COLUMNS = ("actions", "log_probs", "values", "rewards", "episode_numbers", "episode_lengths")
_TYPES = {"log_probs": np.dtype("f4"), "values": np.dtype("f8"), "rewards": np.dtype("f8")}
_EXTRA = "extra."

Doubles = NDArray[np.float64]

LEAST_STEP_BYTES = 16
"""What a step takes at least: action, log-probability, value and reward, four bytes each as version
0.1.0 wrote them."""

LARGEST_FRAMES_BYTES = 1 << 20
"""What the frames of one step take at most. Two cameras of 160 x 120 take 38,400."""

_LARGEST_HEADER_BYTES = 1 << 20


@dataclass(frozen=True)
class Episodes:
    """Whole episodes, one after the other, T steps in E episodes.

    Args:
        frames: What the camera saw before each action, uint8. Shape (T, eyes, height, width).
        actions: Shape (T,) int64 for a list of actions, (T, A) float32 for ranges.
        log_probs: Log-probability of each action when it was chosen. Shape (T,).
        values: What the critic expected at each step. Shape (T,), float64.
        rewards: What followed each action. Shape (T,), float64.
        episode_numbers: Which episodes these are. Shape (E,), int64.
        episode_lengths: Steps of each; their sum is T. Shape (E,), int64.
        extras: More columns by name, of any shape and number type.
        notes: Free, must be JSON.

    Raises:
        ValueError: Lengths or types do not fit.
    """

    frames: NDArray[np.uint8]
    actions: NDArray[Any]
    log_probs: NDArray[np.float32]
    values: Doubles
    rewards: Doubles
    episode_numbers: NDArray[np.int64]
    episode_lengths: NDArray[np.int64]
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    notes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.steps:
            raise ValueError("Episodes without a single step are none.")
        if self.frames.dtype != np.uint8 or self.frames.ndim != 4:
            raise ValueError(
                f"frames are (T, eyes, height, width) uint8, not {_shape(self.frames)}."
            )
        if self.actions.dtype not in (np.int64, np.float32):
            raise ValueError(f"actions are int64 or float32, not {self.actions.dtype}.")
        for name in ("actions", "log_probs", "values", "rewards"):
            column = getattr(self, name)
            if len(column) != self.steps:
                raise ValueError(f"{name} has {len(column)} rows for {self.steps} frames.")
            if name in _TYPES and column.dtype != _TYPES[name]:
                raise ValueError(f"{name} are {_TYPES[name]}, not {column.dtype}.")
        if len(self.episode_numbers) != len(self.episode_lengths):
            raise ValueError("Every episode has one number and one length.")
        if int(self.episode_lengths.sum()) != self.steps:
            raise ValueError(
                f"Episodes of {self.episode_lengths.sum()} steps, {self.steps} frames."
            )

    @property
    def steps(self) -> int:
        """Number of steps of all episodes together."""
        return len(self.frames)

    @property
    def count(self) -> int:
        """Number of episodes."""
        return len(self.episode_lengths)

    def chosen(self, which: NDArray[np.int64]) -> "Episodes":
        """Some of the episodes; this copies their frames.

        Args:
            which: Indices of episodes. Shape (k,).
        """
        ends = np.cumsum(self.episode_lengths)
        begins = ends - self.episode_lengths
        rows = np.concatenate([np.arange(begins[i], ends[i]) for i in which])
        per_step = ("frames", "actions", "log_probs", "values", "rewards")
        per_episode = ("episode_numbers", "episode_lengths")
        return Episodes(
            **{name: getattr(self, name)[rows] for name in per_step},
            **{name: getattr(self, name)[which] for name in per_episode},
            extras={
                name: column[rows if len(column) == self.steps else which]
                for name, column in self.extras.items()
            },
            notes=self.notes,
        )


def pack_episodes(episodes: Episodes) -> bytes:
    """Turn episodes into bytes; the arrays may be used again afterwards."""
    frames = np.ascontiguousarray(episodes.frames)
    packed = zstandard.ZstdCompressor(level=_LEVEL).compress(frames.data.cast("B"))
    tensors = {"frames": np.frombuffer(packed, np.uint8)}
    tensors |= {name: np.ascontiguousarray(getattr(episodes, name)) for name in _COLUMNS}
    tensors |= {_EXTRA + k: np.ascontiguousarray(v) for k, v in episodes.extras.items()}
    header = {
        "schema": SCHEMA,
        "frames_shape": json.dumps(frames.shape),
        "notes": json.dumps(dict(episodes.notes), allow_nan=False),
    }
    return bytes(save(tensors, metadata=header))


def unpack_episodes(data: bytes, *, where: str = "a rollout") -> Episodes:
    """Turn bytes back into episodes.

    Args:
        data: What `pack_episodes` gave.
        where: Name of the object for the error.

    Raises:
        ObjectDamaged: The bytes are something else.
    """
    with _explained(where):
        steps = _Folded.of(data).steps
    return unpack_together([data], steps=steps, where=[where])


def unpack_together(parts: Iterable[bytes], *, steps: int, where: Iterable[str]) -> Episodes:
    """Turn several objects into episodes, one after the other; notes are those of the first.

    Frames are by far the most of it. They unfold straight into their place in one array, object by
    object, so that no more than one of these needs to be in memory at a time.

    Args:
        parts: What `pack_episodes` gave, at least one.
        steps: Of all of them together.
        where: Names of the objects for errors.

    Raises:
        ObjectDamaged: One of the objects is something else, or not like the first, or there are
            more or fewer steps.
    """
    first, frames = None, np.empty(0, np.uint8)
    columns: list[dict[str, NDArray[Any]]] = []
    begin, name = 0, "no object"
    for data, name in zip(parts, where, strict=True):
        with _explained(name):
            part = _Folded.of(data)
            if first is None:
                first = part
                frames = np.empty((steps, *part.frames_shape[1:]), np.uint8)
            part.unfold_into(frames[begin : begin + part.steps])
            begin += part.steps
            columns.append(part.columns)
    with _explained(name):
        if first is None or begin != steps:
            raise ValueError(f"{begin} steps instead of {steps}")
        together = {key: np.concatenate([own[key] for own in columns]) for key in columns[0]}
        for key in ("values", "rewards"):  # float32 in rollouts of version 0.1.0
            together[key] = together[key].astype(np.float64)
        extras = {key: together.pop(key) for key in columns[0] if key not in _COLUMNS}
        return Episodes(
            frames=frames,
            **together,
            extras={key.removeprefix(_EXTRA): column for key, column in extras.items()},
            notes=first.notes,
        )


@dataclass(frozen=True)
class _Folded:
    """An object whose frames are still folded."""

    columns: dict[str, NDArray[Any]]
    frames: NDArray[np.uint8]
    frames_shape: tuple[int, ...]
    notes: dict[str, Any]

    @staticmethod
    def of(data: bytes) -> "_Folded":
        header = _header(data)
        if header.get("schema") != SCHEMA:
            raise ValueError(f"schema {header.get('schema')} instead of {SCHEMA}")
        columns = load(data)
        found = _Folded(
            frames=columns.pop("frames"),
            columns=columns,
            frames_shape=_checked_shape(json.loads(header["frames_shape"])),
            notes=json.loads(header["notes"]),
        )
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
            raise ValueError(f"its folded frames are {_shape(self.frames)}")
        claimed = zstandard.get_frame_parameters(self.frames.data).content_size
        wanted = math.prod(self.frames_shape)
        if claimed != wanted:
            raise ValueError(f"its frames unfold to {claimed} bytes instead of {wanted}")

    @property
    def steps(self) -> int:
        return self.frames_shape[0]

    def unfold_into(self, room: NDArray[np.uint8]) -> None:
        if self.frames_shape != room.shape:
            raise ValueError(f"frames of shape {self.frames_shape} instead of {room.shape}")
        reader = zstandard.ZstdDecompressor().stream_reader(self.frames.data)
        if reader.readinto(room.data.cast("B")) != room.nbytes or reader.read(1):
            raise ValueError("more or fewer frames than it says")


@contextlib.contextmanager
def _explained(where: str) -> Iterator[None]:
    """Say of whatever goes wrong with an object that it is damaged."""
    try:
        yield
    except (
        *(AttributeError, IndexError, KeyError, TypeError, ValueError),
        *(MemoryError, OverflowError, RecursionError),
        *(SafetensorError, zstandard.ZstdError),
    ) as e:
        raise ObjectDamaged(
            f"{where} holds no episodes: {e}.",
            remedy="Let the worker play the iteration again; if it repeats, all machines need the "
            "same version of this program.",
        ) from e


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
