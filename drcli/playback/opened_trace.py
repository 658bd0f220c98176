"""A trace that is being played."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from drcli.base.errors import DrError, SettingsError
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.models.recorded_files import of_parameter_file
from drcli.playback.drivers_policy import DrivingPolicy, policy_of
from drcli.playback.lap_parameters import KnownRace
from drcli.playback.stored_traces import StoredTrace, parse_name, trace_key
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.video.make_video import chosen_laps, rank_of
from drcli.video.recorded_lap import RecordedLap
from drcli.video.trace_source import FoundTrace, trace_of_key
from drcli.video.video_job import Defaults
from drcli.video.world_of_lap import find_world, load_world
from drsim.race.solids import SHAPES, Shape
from drsim.track.track import Track

T = TypeVar("T")

_DIGITS = 3


@dataclass(eq=False)
class OpenedTrace:
    """A trace, read.

    Attributes:
        track: In its own direction; None if unknown.
        eyes: Front cameras of the model.
        used: Parameters that its reward function seems to read.
    """

    trace: StoredTrace
    found: FoundTrace
    track: Track | None
    race: KnownRace
    policy: DrivingPolicy
    eyes: int
    used: list[str]
    notes: list[str]

    def lap(self, index: int) -> RecordedLap:
        """By place, as numbers of episodes may repeat; raises SettingsError."""
        if not 0 <= index < len(self.found.laps):
            raise SettingsError(
                f"{self.found.origin} has {len(self.found.laps)} episodes that can be shown.",
                remedy="Choose one of the list.",
            )
        return self.found.laps[index]

    def facts(self) -> dict[str, Any]:
        laps = self.found.laps
        best = chosen_laps(laps, "best", self.found.origin)[0]
        worst = max(laps, key=rank_of)
        recording = self.found.recording
        return {
            "origin": self.found.origin,
            "kind": self.trace.kind,
            "worker": self.trace.worker,
            "iteration": self.trace.iteration,
            "stamp": self.trace.stamp,
            "notes": self.notes,
            "world": None if self.track is None else self.track.name,
            "race_type": self.race.race_type,
            "racer": "" if recording is None else recording.racer,
            "outline": None if self.track is None else outline(self.track),
            "policy": self.policy,
            "used_parameters": self.used,
            "objects": [shape.name for shape in self.race.shapes],
            "eyes": self.eyes,
            "episodes": [
                {
                    "index": index,
                    **_summary(lap, self.track),
                    "mark": "best"
                    if lap is best and len(laps) > 1
                    else "worst"
                    if lap is worst and len(laps) > 1
                    else "",
                }
                for index, lap in enumerate(laps)
            ],
        }


def open_trace(bucket: Bucket, defaults: Defaults, prefix: str, name: str) -> OpenedTrace:
    """Read a trace with everything known about it.

    Raises:
        SettingsError: Wrong names, or not a simtrace.
        StorageError: It is missing, or the bucket cannot be read.
    """
    key = trace_key(prefix, name)
    trace = parse_name(name)
    assert trace is not None
    found = trace_of_key(bucket, prefix, key, _title(trace), "")
    notes = list(found.notes)
    unknown: dict[str, Any] = {}
    told = _or(lambda: of_parameter_file(bucket, prefix), unknown, notes)
    track = _track(found, defaults, str(told.get("world", "")), notes)
    policy = policy_of(bucket, defaults.model, prefix, trace, found)
    eyes = _or(
        lambda: ModelMetadata.from_bytes(bucket.get(keys.model_metadata(prefix))).eyes, 1, notes
    )
    none: list[str] = []
    used = _or(lambda: used_parameters(bucket.get(keys.reward_function(prefix))), none, notes)
    race = _race(trace, found, str(told.get("race_type", "")))
    return OpenedTrace(trace, found, track, race, policy, eyes, used, notes)


def outline(track: Track) -> dict[str, Any]:
    """A map's lines, in metres with millimetres."""

    def line(points: np.ndarray) -> list[list[float]]:
        rounded: list[list[float]] = np.round(points, _DIGITS).tolist()
        return rounded

    return {
        "name": track.name,
        "closed": track.closed,
        "length_m": track.length_m,
        "center": line(track.center),
        "inner": line(track.inner),
        "outer": line(track.outer),
    }


def used_parameters(text: bytes) -> list[str]:
    """Quoted words that may be names of parameters."""
    words = re.findall(r"""["']([a-z_]{1,40})["']""", text.decode("utf-8", "replace"))
    return list(dict.fromkeys(words))


def _title(trace: StoredTrace) -> str:
    if trace.kind == "training":
        return f"training iteration {trace.iteration}, worker {trace.worker}"
    return f"evaluation {trace.stamp}" if trace.stamp else "the last race as the opponent"


def _summary(lap: RecordedLap, track: Track | None) -> dict[str, Any]:
    start_m = None
    if track is not None:
        start_m = float(track.locate(np.ascontiguousarray(lap.poses[:1, :2])).distance_m[0])
    return {
        "number": lap.number,
        "steps": len(lap.time_s),
        "reward": float(np.nansum(lap.reward)),
        "progress": float(lap.progress[-1]),
        "seconds": lap.duration_s,
        "completed": lap.completed,
        "resets": int(lap.resets[-1]),
        "penalty_s": lap.penalty_s,
        "clean": lap.clean,
        "text": lap.told,
        "status": lap.status[-1],
        "start_m": start_m,
        "start_percent": None
        if start_m is None or track is None
        else 100.0 * start_m / track.length_m,
    }


def _race(trace: StoredTrace, found: FoundTrace, told: str) -> KnownRace:
    recording = found.recording
    if recording is None:
        return KnownRace(told if trace.kind == "training" else "")
    shapes: tuple[Shape, ...] = tuple(SHAPES[name] for name in recording.shapes if name in SHAPES)
    whole = len(shapes) == len(recording.shapes) == found.laps[0].objects.shape[1]
    return KnownRace(recording.race_type, shapes if whole else (), recording.reverse)


def _track(found: FoundTrace, defaults: Defaults, told: str, notes: list[str]) -> Track | None:
    folder = defaults.tracks_folder
    try:
        if found.recording is not None:
            return load_world(found.recording.world, folder)
        return find_world(found.laps, told or defaults.world, folder, found.origin)
    except SettingsError as error:
        notes.append(
            f"{error} So there are no camera pictures, no map and no parameters of the track. "
            "`dr-tracks fetch NAME` brings tracks."
        )
        return None


def _or(read: Callable[[], T], otherwise: T, notes: list[str]) -> T:
    """Missing or damaged data gives `otherwise`; damage is noted."""
    try:
        return read()
    except ObjectMissing:
        return otherwise
    except DrError as error:
        notes.append(str(error))
        return otherwise
