"""How far a policy gets with each of the simulator's cars."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from drcli.base.json_record import RecordError, from_json, parse_json

TRIALS_FILE = "cars.json"


@dataclass(frozen=True)
class CarTrial:
    """What one car achieved.

    Attributes:
        car: Name of the set, a value of DR_SIM_CAR.
        laps: Starts that completed a full lap.
        starts: All starts.
        mean_progress: Percent of the lap.
        lap_times_s: Of the full laps, simulated seconds.
    """

    car: str
    laps: int
    starts: int
    mean_progress: float
    lap_times_s: list[float]


@dataclass(frozen=True)
class CarTrials:
    """What all cars achieved.

    Attributes:
        world: The track.
        cars: One trial for each car.
        best: The car that suits the model: that of the settings, unless another completes more laps
            than by chance.
        present: The car of the settings.
    """

    world: str
    cars: list[CarTrial]
    best: str
    present: str


@dataclass(frozen=True)
class _File:
    cars: list[CarTrial]


def encode_trials(trials: Sequence[CarTrial]) -> bytes:
    cars: list[dict[str, Any]] = [asdict(trial) for trial in trials]
    return json.dumps({"cars": cars}, allow_nan=False).encode()


def decode_trials(data: bytes) -> list[CarTrial]:
    found = from_json(_File, parse_json(data)).cars
    if not found:
        raise RecordError("it has no cars")
    return found
