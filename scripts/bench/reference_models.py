"""How far a frozen policy gets on a track, with each of the cars that models have learned.

    python scripts/bench_reference_models.py --model FILE.pb --metadata FILE --world NAME
        [--tracks-dir DIR] [--starts 16] [--car NAME|all] [--json]

The policy takes its likeliest action in every step. Starts are spread evenly over the lap, from
standstill; an episode ends with a full lap or when the car leaves the track. Our own interpreter
computes the graph. The last line of stdout is one object

    {"cars": [{"car", "laps", "starts", "mean_progress", "lap_times_s"}]}

with the number of starts that completed a full lap, the mean progress in percent, and the times of
the full laps in the order of their starts. With --json nothing else is printed there. If the input
cannot be used, one sentence on stderr says why, and the exit code is 3.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from machine import print_json
from numpy.typing import NDArray

from drcli.base.errors import DrError, SettingsError, one_of, shown
from drcli.convert.tensorflow.graph import decode_graph
from drcli.convert.tensorflow.interpreter import Graph
from drcli.drive.build_race import actions_of, longest_episode, sensors_of_model
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.sensors import LIDARS
from drsim.car.car_parameters import CAR_SETS, DEFAULT_CAR
from drsim.episode.episode_rules import EpisodeRules, Status
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.errors import TrackError
from drsim.sensing.scene import Scene, build_scene
from drsim.track.track import Track
from drsim.track.worlds import load_track

ALL_CARS = "all"

MOST_STARTS = 1000

SAMPLES = 16
"""How many cars the graph is computed for at once: more would only take more memory."""


@dataclass(frozen=True)
class Result:
    """What one car achieved, as in the printed object."""

    car: str
    laps: int
    starts: int
    mean_progress: float
    lap_times_s: list[float]


class Driver:
    """A frozen policy and the file that says what its inputs and outputs mean."""

    def __init__(self, graph: Graph, metadata: ModelMetadata) -> None:
        """Compare the two.

        Raises:
            SettingsError: They do not fit each other.
        """
        self.metadata = metadata
        self.actions = actions_of(metadata)
        self._graph = graph
        self._sensors = {name: name.rsplit("/", 1)[-1] for name in graph.inputs}
        taken, given = sorted(self._sensors.values()), sorted(metadata.sensor)
        if taken != given:
            raise _misfit(graph, f"takes {_words(taken)}, but the metadata have {_words(given)}")
        for name, shape in graph.inputs.items():
            wanted = self._shape(self._sensors[name])
            fits = len(shape) == 0 or (
                len(shape) == len(wanted) + 1
                and all(size in (-1, own) for size, own in zip(shape[1:], wanted, strict=True))
            )
            if not fits:
                raise _misfit(
                    graph,
                    f"takes {self._sensors[name]} in the shape {list(shape)} instead of "
                    f"{[-1, *wanted]}",
                )
        blank = {
            name: np.zeros((1, *self._shape(s)), np.float32) for name, s in self._sensors.items()
        }
        output = graph.run(blank)
        space = metadata.action_space
        wanted_outputs = 2 if space.continuous else len(space.values)
        if output.shape != (1, wanted_outputs):
            raise _misfit(
                graph,
                f"has an output of shape {list(output.shape[1:])}, but the metadata have "
                f"{wanted_outputs} {'dimensions of actions' if space.continuous else 'actions'}",
            )

    def act(self, frames: NDArray[np.uint8], scans: NDArray[np.float32]) -> NDArray[np.floating]:
        """The output for what cars perceive.

        Args:
            frames: Grey values. Shape (n, eyes, 120, 160).
            scans: Values of the lidar. Shape (n, d).

        Returns:
            Probabilities of the actions, or continuous actions. Shape (n, k).
        """
        pictures = np.moveaxis(frames, 1, -1)
        parts = []
        for first in range(0, len(frames), SAMPLES):
            some = slice(first, first + SAMPLES)
            inputs = {
                name: (scans if sensor in LIDARS else pictures)[some].astype(np.float32)
                for name, sensor in self._sensors.items()
            }
            parts.append(self._graph.run(inputs))
        return np.concatenate(parts)

    def likeliest(self, outputs: NDArray[np.floating]) -> NDArray[np.generic]:
        """The likeliest actions of outputs, as the action space takes them."""
        return outputs if self.metadata.action_space.continuous else outputs.argmax(axis=1)

    def _shape(self, sensor: str) -> tuple[int, ...]:
        """Shape of one sample of a sensor."""
        if sensor in LIDARS:
            return (self.metadata.scan_dims,)
        return (120, 160, self.metadata.eyes)


def _misfit(graph: Graph, what: str) -> SettingsError:
    remedy = "Use the model_metadata.json that this model was trained with."
    return SettingsError(f"{graph.origin} {what}.", remedy=remedy)


def _words(names: Sequence[str]) -> str:
    return " and ".join(names) or "nothing"


def load_driver(model: Path, metadata: Path) -> Driver:
    """Read both files.

    Raises:
        SettingsError: One of them cannot be read, or they do not fit each other.
    """
    described = ModelMetadata.from_bytes(_content(metadata), str(metadata))
    graph = Graph(decode_graph(_content(model), str(model)), str(model))
    return Driver(graph, described)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be read ({error.strerror}).", remedy="Correct the path."
        ) from None


def drive(track: Track, scene: Scene, driver: Driver, car: str, starts: int) -> Result:
    """One episode from each start, all at the same time."""
    simulation = Simulation(
        track,
        num_cars=starts,
        reward_function=centre_line_reward,
        rules=EpisodeRules(max_steps=longest_episode(track, driver.actions)),
        num_threads=os.cpu_count() or 1,
        scene=scene,
        car_parameters=CAR_SETS[car].parameters,
        sensors=sensors_of_model(driver.metadata),
    )
    running = np.ones(starts, np.bool_)
    lapped = np.zeros(starts, np.bool_)
    progress, lap_time_s = np.zeros(starts), np.zeros(starts)
    outputs: NDArray[np.floating] | None = None
    try:
        simulation.reset(np.arange(starts), np.arange(starts) / starts)
        while running.any():
            seen = driver.act(simulation.frames[running], simulation.scans[running])
            if outputs is None:
                outputs = np.zeros((starts, seen.shape[1]), seen.dtype)
            outputs[running] = seen
            row = simulation.step(*driver.actions.requests(driver.likeliest(outputs)))
            over = running & row.done
            progress[over] = row.progress[over]
            lapped[over] = row.status[over] == Status.LAP_COMPLETE
            lap_time_s[over] = row.lap_time_s[over]
            running &= ~over
    finally:
        simulation.close()
    return Result(
        car=car,
        laps=int(lapped.sum()),
        starts=starts,
        mean_progress=round(float(progress.mean()), 3),
        lap_times_s=[round(seconds, 3) for seconds in lap_time_s[lapped].tolist()],
    )


def main() -> int:
    """Drive, print; the exit code is 3 if the input cannot be used."""
    options = _parser().parse_args()
    try:
        starts = _count(options.starts)
        cars = _cars(options.car)
        track = load_track(options.world, options.tracks_dir)
        driver = load_driver(options.model, options.metadata)
        scene = build_scene(track)
        results = [drive(track, scene, driver, car, starts) for car in cars]
    except DrError as error:
        print(f"{error} {error.remedy}", file=sys.stderr)
        return error.code
    except TrackError as error:
        print(error, file=sys.stderr)
        return SettingsError.code
    if not options.json:
        for result in results:
            print(_text(result))
    print_json({"cars": [asdict(result) for result in results]})
    return 0


def _cars(given: str) -> list[str]:
    if given == ALL_CARS:
        return list(CAR_SETS)
    if given not in CAR_SETS:
        remedy = one_of([*CAR_SETS, ALL_CARS], given)
        raise SettingsError(f"--car {shown(given)} is not a car.", remedy=remedy)
    return [given]


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= MOST_STARTS:
        raise SettingsError(
            f"--starts {text} is not a number from 1 to {MOST_STARTS}.", remedy="Write --starts 16."
        )
    return int(text)


def _text(result: Result) -> str:
    text = (
        f"{result.car:10} {result.laps:3} of {result.starts} laps, "
        f"{result.mean_progress:6.2f} % mean progress"
    )
    if result.lap_times_s:
        text += f", {min(result.lap_times_s):.2f} to {max(result.lap_times_s):.2f} s a lap"
    return text


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--model", type=Path, required=True, help="frozen graph, a .pb file")
    parser.add_argument("--metadata", type=Path, required=True, help="its model_metadata.json")
    parser.add_argument("--world", required=True, help="track, or its route file")
    parser.add_argument(
        "--tracks-dir", type=Path, default=os.environ.get("DR_TRACKS_DIR"), help="route files"
    )
    parser.add_argument("--starts", default="16", help="how many, spread evenly over the lap")
    parser.add_argument(
        "--car", default=DEFAULT_CAR, help=f"one of {', '.join(CAR_SETS)}, or {ALL_CARS}"
    )
    parser.add_argument("--json", action="store_true", help="print the object only")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
