"""Answers a viewer's requests about stored episodes; heavy to import."""

import re
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from drcli.base.errors import DrError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.config.run_config import ModelConfig
from drcli.model import keys
from drcli.model.checkpoint_choice import ModelCheckpoints
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_history
from drcli.records.checkpoint import CHECKPOINT_NAME
from drcli.tracks.outline import outline
from drcli.transfer.record_training import of_parameter_file
from drcli.view.playback.lap_parameters import KnownRace, directed_track, lap_parameters
from drcli.view.playback.player_handle import pack
from drcli.view.playback.stored_traces import StoredTrace, parse_name, trace_key
from drcli.view.video.make_video import chosen_laps, rank_of
from drcli.view.video.overlay import encoded
from drcli.view.video.recorded_lap import RecordedLap, find_world, load_world
from drcli.view.video.trace_source import FoundTrace, trace_of_key
from drcli.view.video.video_job import Defaults
from drsim.arrays import Bytes, Floats, Singles
from drsim.car.actions import DiscreteActions
from drsim.race.solids import SHAPES, Shape
from drsim.track.track import Track
from drsim.viewing.car_eye import CarEye

if TYPE_CHECKING:
    from drcli.view.saliency.policy_outputs import ExplainedPolicy, PolicyOutputs

with lazy_imports():
    import torch

    from drcli.learn import policy as learn_policy
    from drcli.view.saliency import explanation_pictures, policy_outputs
    from drcli.view.video import policy_insight


# Which policy drove a trace, and how it is opened.


@dataclass(frozen=True)
class DrivingPolicy:
    """The policy of a trace.

    Attributes:
        checkpoint: Null if unknown.
        available: Checkpoints that can be opened.
        sentence: Why it cannot be shown, or empty.
    """

    checkpoint: int | None
    available: list[int]
    sentence: str


def policy_of(
    model: ModelStore, config: ModelConfig, trace: StoredTrace, found: FoundTrace
) -> DrivingPolicy:
    available = _available(model, config)
    number = _recorded(found)
    if trace.kind == "training":
        number = _of_iteration(model, config, trace.iteration)
    if number is None:
        sentence = "Nobody recorded which checkpoint drove, so no choices are shown."
    elif number in available:
        sentence = ""
    else:
        sentence = (
            f"Checkpoint {number}, which drove, is no longer there: a training keeps the newest, "
            "the best and the milestones."
        )
    if sentence and available:
        sentence += " Another checkpoint can look at the same pictures."
    return DrivingPolicy(number, available, sentence)


def open_checkpoint(model: ModelStore, config: ModelConfig, number: int) -> "ExplainedPolicy":
    """The network, or the frozen graph where only that is left.

    Raises:
        SettingsError: It cannot be found or used.
        StorageError: It is damaged, or the bucket cannot be read.
    """
    name = ""
    try:
        own = ModelStore.of(config, model.bucket, model.prefix)
        name = ModelCheckpoints.read(own).choose(number).name
    except SettingsError:
        if not model.bucket.exists(keys.checkpoint_graph(model.prefix, number)):
            raise
    if name:
        return policy_outputs.open_policy(model, name)
    with tempfile.TemporaryDirectory(prefix="dr-policy-") as folder:
        graph, metadata = Path(folder, f"model_{number}.pb"), Path(folder, "model_metadata.json")
        graph.write_bytes(model.bucket.get(keys.checkpoint_graph(model.prefix, number)))
        metadata.write_bytes(model.bucket.get(keys.model_metadata(model.prefix)))
        return policy_outputs.open_policy_file(graph, metadata)


def _available(model: ModelStore, config: ModelConfig) -> list[int]:
    checkpoints = ModelCheckpoints.read(ModelStore.of(config, model.bucket, model.prefix))
    there = {info.key for info in checkpoints.listed}
    whole = {name.number for name in checkpoints.names if not checkpoints.missing_parts(str(name))}
    graphs = {
        name.number
        for name in checkpoints.names
        if keys.checkpoint_graph(model.prefix, name.number) in there
    }
    return sorted(whole | graphs)


def _recorded(found: FoundTrace) -> int | None:
    recorded = "" if found.recording is None else found.recording.checkpoint
    name = CHECKPOINT_NAME.fullmatch(recorded)
    return None if name is None else int(name[1])


def _of_iteration(model: ModelStore, config: ModelConfig, iteration: int) -> int:
    """Where driving and learning overlap, an older checkpoint drove."""
    try:
        records, _ = readable_history(ModelStore.of(config, model.bucket, model.prefix))
    except DrError:
        records = []
    for record in records:
        name = CHECKPOINT_NAME.fullmatch(record.checkpoint)
        if record.iteration == iteration and name is not None:
            return int(name[1])
    return iteration


# A trace that is being played.


T = TypeVar("T")


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
            "reverse": self.race.reverse is True,
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


def open_trace(model: ModelStore, defaults: Defaults, name: str) -> OpenedTrace:
    """Read a trace with everything known about it.

    Raises:
        SettingsError: Wrong names, or not a simtrace.
        StorageError: It is missing, or the bucket cannot be read.
    """
    key = trace_key(model.prefix, name)
    trace = parse_name(name)
    assert trace is not None
    found = trace_of_key(model, key, _title(trace), "")
    notes = list(found.notes)
    told = _or(lambda: of_parameter_file(model), dict[str, Any](), notes)
    track = _track(found, defaults, str(told.get("world", "")), notes)
    policy = policy_of(model, defaults.model, trace, found)
    eyes = _or(
        lambda: ModelMetadata.from_bytes(model.bucket.get(keys.model_metadata(model.prefix))).eyes,
        1,
        notes,
    )
    used = _or(
        lambda: used_parameters(model.bucket.get(keys.reward_function(model.prefix))),
        list[str](),
        notes,
    )
    race = _race(trace, found, str(told.get("race_type", "")))
    return OpenedTrace(trace, found, track, race, policy, eyes, used, notes)


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


MOST_STEPS = 128
"""Per request; pictures of a step take about 3 kB."""

MOST_EXPLAINED = 32
"""Maps per request, at a few network passes each."""

CACHE_BYTES = 48 << 20
_TRACES, _EYES, _POLICIES = 4, 2, 2
"""A trace takes some MB, a painted world up to 55, a policy up to 20."""

_SAMPLES = 9

V = TypeVar("V")


class RecentlyUsed(Generic[V]):
    """The values that were used last, up to a sum of sizes."""

    def __init__(self, most: int, size: Callable[[V], int] = lambda _: 1) -> None:
        self._most, self._size_of = most, size
        self._values: OrderedDict[Any, V] = OrderedDict()
        self.size = 0

    def find(self, key: Any) -> V | None:
        if key in self._values:
            self._values.move_to_end(key)
        return self._values.get(key)

    def get(self, key: Any, make: Callable[[], V]) -> V:
        found = self.find(key)
        return self.keep(key, make()) if found is None else found

    def keep(self, key: Any, value: V) -> V:
        self.drop(lambda other: other == key)
        self._values[key] = value
        self.size += self._size_of(value)
        while self.size > self._most:
            self.size -= self._size_of(self._values.popitem(last=False)[1])
        return value

    def drop(self, of: Callable[[Any], bool]) -> None:
        for key in [key for key in self._values if of(key)]:
            self.size -= self._size_of(self._values.pop(key))


class EpisodePlayer:
    """Plays stored episodes; `connect` is called anew for each trace."""

    def __init__(self, connect: Callable[[], tuple[Bucket, Defaults]]) -> None:
        self._connect = connect
        self._traces: RecentlyUsed[OpenedTrace] = RecentlyUsed(_TRACES)
        self._eyes: RecentlyUsed[CarEye] = RecentlyUsed(_EYES)
        self._policies: RecentlyUsed[ExplainedPolicy] = RecentlyUsed(_POLICIES)
        self._most: RecentlyUsed[float] = RecentlyUsed(64)
        self.pictures: RecentlyUsed[bytes] = RecentlyUsed(CACHE_BYTES, len)

    def answer(self, request: dict[str, Any]) -> bytes:
        """The answer in the form of `packed_answer`.

        `do` is `open`, `lap`, `steps`, `policy` or `explain`; `model` and `trace` name the trace;
        all but `open` take `episode`, and the last three `first` and `count`.

        Raises:
            SettingsError: Something does not exist.
            StorageError: The bucket cannot be read.
            NotAvailable: A library is missing.
        """
        model, name = str(request["model"]), str(request["trace"])
        if request["do"] == "open":
            # It may have been written again since: a model was wiped and trained anew.
            self._traces.drop(lambda key: key == (model, name))
            self.pictures.drop(lambda key: key[:2] == (model, name))
            self._policies.drop(lambda key: key[0] == model)
            self._most.drop(lambda key: key[:2] == (model, name))
            return pack(self._opened(model, name).facts())
        opened = self._opened(model, name)
        index = int(request["episode"])
        lap = opened.lap(index)
        if request["do"] == "lap":
            return pack(lap_columns(lap))
        first, count = _range(request, lap)
        if request["do"] == "steps":
            return self._steps(opened, model, index, first, count)
        checkpoint = int(request["checkpoint"])
        if request["do"] == "policy":
            return self._choices(opened, model, lap, first, count, checkpoint)
        return self._explained(opened, model, index, first, count, checkpoint)

    def _opened(self, model: str, name: str) -> OpenedTrace:
        def read() -> OpenedTrace:
            bucket, defaults = self._connect()
            return open_trace(ModelStore(bucket, model), defaults, name)

        return self._traces.get((model, name), read)

    def _eye(self, opened: OpenedTrace) -> CarEye:
        track = opened.track
        if track is None:
            raise SettingsError(
                f"The track of {opened.found.origin} is not known, so there are no pictures.",
                remedy="Fetch the track with `dr-tracks fetch NAME`.",
            )
        shapes = opened.race.shapes
        names = tuple(shape.name for shape in shapes)
        return self._eyes.get((track.name, names), lambda: CarEye(track, shapes))

    def _steps(self, opened: OpenedTrace, model: str, index: int, first: int, count: int) -> bytes:
        lap = opened.lap(index)
        facts: dict[str, Any] = {"first": first, "count": count, "parameters": None}
        files: list[bytes] = []
        if opened.track is not None:
            track = directed_track(opened.track, lap, opened.race)
            facts["parameters"] = asdict(lap_parameters(track, lap, opened.race, first, count))
            files = self._pictures(opened, model, index, first, count)
        return pack(facts, files)

    def _pictures(
        self, opened: OpenedTrace, model: str, index: int, first: int, count: int
    ) -> list[bytes]:
        lap, name = opened.lap(index), opened.trace.name
        there = {
            row: self.pictures.find((model, name, index, row))
            for row in range(first, first + count)
        }
        missing = [row for row, file in there.items() if file is None]
        if missing:
            frames = self._eye(opened).frames(
                lap.poses[missing], _objects(lap, opened, missing), opened.eyes
            )
            for row, eyes in zip(missing, frames, strict=True):
                file = encoded(np.concatenate(list(eyes), axis=1), "JPEG")
                there[row] = self.pictures.keep((model, name, index, row), file)
        return [file or b"" for file in there.values()]

    def _policy(self, model: str, checkpoint: int) -> "ExplainedPolicy":
        def read() -> "ExplainedPolicy":
            torch.set_num_threads(1)
            bucket, defaults = self._connect()
            return open_checkpoint(ModelStore(bucket, model), defaults.model, checkpoint)

        return self._policies.get((model, checkpoint), read)

    def _choices(
        self,
        opened: OpenedTrace,
        model: str,
        lap: RecordedLap,
        first: int,
        count: int,
        checkpoint: int,
    ) -> bytes:
        subject = self._policy(model, checkpoint)
        seen = self._seen(opened, subject, lap, range(first, first + count))

        return pack(
            {
                "first": first,
                "count": count,
                "checkpoint": checkpoint,
                **choices(
                    policy_outputs.outputs_of(subject, learn_policy.Observation.of_arrays(*seen)),
                    subject,
                ),
            }
        )

    def _explained(
        self,
        opened: OpenedTrace,
        model: str,
        index: int,
        first: int,
        count: int,
        checkpoint: int,
    ) -> bytes:
        rows = range(first, first + min(count, MOST_EXPLAINED))
        name, lap = opened.trace.name, opened.lap(index)
        place = (model, name, index, checkpoint)
        there = {row: self.pictures.find((*place, row)) for row in rows}
        missing = [row for row, file in there.items() if file is None]
        if missing:
            subject = self._policy(model, checkpoint)
            full = self._most.get(place, lambda: self._strongest(opened, subject, lap))
            frames, maps = self._maps(opened, subject, lap, missing)
            eyes = subject.policy.spec.eyes
            for row, frame, values in zip(missing, frames, maps, strict=True):
                # Of a stack, the newest picture of the first eye.
                picture = explanation_pictures.overlay(frame[len(frame) - eyes], values, full)
                there[row] = self.pictures.keep((*place, row), encoded(picture, "JPEG"))
        facts = {"first": first, "count": len(there), "checkpoint": checkpoint}
        return pack(facts, [file or b"" for file in there.values()])

    def _strongest(
        self, opened: OpenedTrace, subject: "ExplainedPolicy", lap: RecordedLap
    ) -> float:
        rows = sorted({round(at) for at in np.linspace(0, len(lap.time_s) - 1, _SAMPLES)})
        return explanation_pictures.full_of(self._maps(opened, subject, lap, rows)[1])

    def _maps(
        self,
        opened: OpenedTrace,
        subject: "ExplainedPolicy",
        lap: RecordedLap,
        rows: Iterable[int],
    ) -> tuple[Bytes, Singles]:
        frames, scans, states = self._seen(opened, subject, lap, rows)
        return frames, policy_insight.action_maps(subject, frames, scans, states)

    def _seen(
        self,
        opened: OpenedTrace,
        subject: "ExplainedPolicy",
        lap: RecordedLap,
        rows: Iterable[int],
    ) -> tuple[Bytes, Singles, Singles]:
        eye, spec, chosen = self._eye(opened), subject.policy.spec, list(rows)
        needed = sorted({max(row - back, 0) for row in chosen for back in range(spec.stack)})
        frames = eye.frames(lap.poses[needed], _objects(lap, opened, needed), spec.eyes)
        parts = [
            frames[np.searchsorted(needed, [max(row - back, 0) for row in chosen])]
            for back in reversed(range(spec.stack))
        ]
        whole = np.concatenate(parts, axis=1)
        scans = eye.scans(lap.poses[chosen], _objects(lap, opened, chosen), subject.sensors)
        return whole, scans, np.zeros((len(chosen), 0), np.float32)


def choices(outputs: "PolicyOutputs", subject: "ExplainedPolicy") -> dict[str, Any]:
    def rounded(values: Floats | None, digits: int = 4) -> Any:
        return None if values is None else np.round(values, digits).tolist()

    actions = subject.actions
    reason = ""
    if outputs.value is None:
        reason = (
            "The critic of this model sees the state of the car, which a trace does not have."
            if subject.policy.spec.state_dims
            else "There is no critic in the file of this policy."
        )
    return {
        "actions": [list(pair) for pair in actions.choices]
        if isinstance(actions, DiscreteActions)
        else None,
        "probabilities": rounded(outputs.probabilities),
        "steering_deg": rounded(outputs.steering_deg),
        "speed_mps": rounded(outputs.speed_mps),
        "low": rounded(outputs.low),
        "high": rounded(outputs.high),
        "entropy": rounded(outputs.entropy),
        # As small as the rewards of the model, whose scale is the racer's.
        "value": None
        if outputs.value is None
        else [float(f"{value + 0.0:.6g}") for value in outputs.value.tolist()],
        "no_value": reason,
    }


_STATES = {
    "immobilized": "Did not move",
    "reversed": "Drove backwards",
    "pause": "Waits",
    "prepare": "Starts",
    "park": "Parked",
    "time_up": "Time is up",
}
"""Of a step, in words; others say it themselves."""


def _words(status: str) -> str:
    return status.replace("_", " ").capitalize()


def lap_columns(lap: RecordedLap) -> dict[str, Any]:
    def rounded(values: Floats, digits: int) -> Any:
        return np.round(values, digits).tolist()

    return {
        "number": lap.number,
        "step": rounded(lap.steps, 0),
        "time_s": rounded(lap.time_s, 4),
        "x": rounded(lap.poses[:, 0], 4),
        "y": rounded(lap.poses[:, 1], 4),
        "yaw_rad": rounded(lap.poses[:, 2], 4),
        "steering_deg": rounded(lap.steering_deg, 3),
        "speed_mps": rounded(lap.speed_mps, 3),
        "driven_mps": rounded(lap.driven_mps, 3),
        "reward": rounded(lap.reward, 6),
        "progress": rounded(lap.progress, 3),
        "pause_s": rounded(lap.pause_s, 3),
        "resets": lap.resets.tolist(),
        "state": [_STATES.get(status, _words(status)) for status in lap.status],
        "action": list(lap.action),
        "objects": [rounded(each, 3) for each in lap.objects[: 1 if _stands(lap) else None]],
    }


def _stands(lap: RecordedLap) -> bool:
    return bool((lap.objects == lap.objects[:1]).all())


def _objects(lap: RecordedLap, opened: OpenedTrace, rows: list[int]) -> Floats:
    return lap.objects[rows] if opened.race.shapes else np.empty((len(rows), 0, 3))


def _range(request: dict[str, Any], lap: RecordedLap) -> tuple[int, int]:
    first, count = int(request["first"]), int(request["count"])
    rows = len(lap.time_s)
    if not (0 <= first < rows and 1 <= count <= MOST_STEPS):
        raise SettingsError(
            f"The episode has no {count} steps from number {first} on: it has {rows}.",
            remedy=f"Ask for at most {MOST_STEPS} steps of it.",
        )
    return first, min(count, rows - first)
