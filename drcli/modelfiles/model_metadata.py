"""model_metadata.json: actions, sensors, network and algorithm of a model, checked key by key."""

import json
from collections.abc import Callable
from typing import Any

from pydantic import BaseModel, ConfigDict

from drcli.base.problems import Finding, closest, one_of, settings_error, shown
from drcli.modelfiles.action_space import ActionSpace, ActionSpaceReader
from drcli.modelfiles.json_file import JsonFile, as_written, read_json_object

NETWORKS = (
    "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
    "DEEP_CONVOLUTIONAL_NETWORK",
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP",
    "COMPACT_CONVOLUTIONAL_NETWORK",
)
"""The reference's three, and a small one of our own that learns faster."""
SINGLE_CAMERAS = ("FRONT_FACING_CAMERA", "observation", "LEFT_CAMERA")
"""Three names of one grey picture."""
CAMERAS = (*SINGLE_CAMERAS, "STEREO_CAMERAS")
LIDARS = ("LIDAR", "SECTOR_LIDAR", "DISCRETIZED_SECTOR_LIDAR")
ALGORITHMS = ("clipped_ppo", "sac")
SPACE_TYPES = ("discrete", "continuous")
VERSIONS = (1, 2, 3, 4, 5, 6)
KEYS = (
    "action_space",
    "action_space_type",
    "training_algorithm",
    "neural_network",
    "sensor",
    "version",
    "lidar_config",
)


class LidarConfig(BaseModel):
    """`lidar_config`: what DISCRETIZED_SECTOR_LIDAR makes of the rays."""

    model_config = ConfigDict(frozen=True)

    num_sectors: int = 8
    num_values_per_sector: int = 8
    clipping_dist: float = 2.0
    """Metres."""


class ModelMetadata(BaseModel):
    """What a model is made of; missing keys have the reference simulator's defaults.

    Attributes:
        action_space: The actions.
        training_algorithm: clipped_ppo or sac.
        neural_network: Name of the network's body.
        sensor: What the car sees with.
        version: Version of the car, `1` to `6`, as text.
        lidar: Sectors of a lidar.
        original: The file's content, byte by byte, to be copied into the bucket.
        action_space_json: The file's `action_space`, for readers of its own layout.
        notes: What is legal but odd, each with what to do about it.
    """

    model_config = ConfigDict(frozen=True)

    action_space: ActionSpace
    training_algorithm: str
    neural_network: str
    sensor: tuple[str, ...]
    version: str
    lidar: LidarConfig = LidarConfig()
    original: bytes
    action_space_json: str
    notes: tuple[Finding, ...]

    @staticmethod
    def from_bytes(data: bytes, name: str = "model_metadata.json") -> "ModelMetadata":
        """Read a file's content.

        Args:
            data: The content.
            name: What to call the file in messages.

        Raises:
            SettingsError: A value is missing, unknown or does not fit the others.
        """
        return _Reader(read_json_object(data, name), data).read()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notes as sentences."""
        return tuple(map(str, self.notes))

    @property
    def eyes(self) -> int:
        """Pictures that the camera takes at a time."""
        return 2 if "STEREO_CAMERAS" in self.sensor else 1

    @property
    def scan_dims(self) -> int:
        """Values that the lidar gives, 0 without one. Source: the reference simulator's filters."""
        discretized = self.lidar.num_sectors * self.lidar.num_values_per_sector
        values = {"LIDAR": 64, "SECTOR_LIDAR": 8, "DISCRETIZED_SECTOR_LIDAR": discretized}
        return sum(values.get(name, 0) for name in self.sensor)

    @property
    def action_space_type(self) -> str:
        """The kind of actions: discrete or continuous."""
        return "continuous" if self.action_space.continuous else "discrete"


class _Reader:
    """One file: gathers findings and notes until it can raise or return."""

    def __init__(self, file: JsonFile, original: bytes) -> None:
        self._file = file
        self._original = original
        self._findings: list[Finding] = []
        self._notes: list[Finding] = []

    def read(self) -> ModelMetadata:
        self._unknown_keys()
        algorithm = self._word("training_algorithm", ALGORITHMS)
        space_type = self._word("action_space_type", SPACE_TYPES)
        network = self._word("neural_network", NETWORKS)
        space = self._action_space(space_type)
        version = self._version()
        sensor = self._sensor(float(version))
        lidar = LidarConfig()
        if "DISCRETIZED_SECTOR_LIDAR" in sensor:
            lidar = self._lidar_config()
        if algorithm == "sac" and space_type == "discrete":
            self._reject(
                "training_algorithm",
                "needs continuous actions",
                'Write "action_space_type": "continuous" with ranges, '
                'or "training_algorithm": "clipped_ppo".',
            )
        if self._findings:
            raise settings_error(self._findings)
        return ModelMetadata(
            action_space=space,
            training_algorithm=algorithm,
            neural_network=network,
            sensor=sensor,
            version=version,
            lidar=lidar,
            original=self._original,
            action_space_json=json.dumps(self._file.values["action_space"]),
            notes=tuple(self._notes),
        )

    def _unknown_keys(self) -> None:
        for key, written in self._file.values.items():
            if key in KEYS:
                continue
            meant = closest(key, KEYS, cutoff=0.75)
            where = self._file.where(key)
            if meant is None:
                what = f"{shown(key)} has no meaning here"
                self._notes.append(Finding(where, what, "Keep or remove the line."))
            else:
                what = f"{shown(key)}={as_written(written)} is no key of this file"
                self._findings.append(Finding(where, what, f"Did you mean {meant}?"))

    def _word(self, key: str, words: tuple[str, ...]) -> str:
        """One of the words in any letter case; the first word is the default."""
        written = self._file.values.get(key, words[0])
        spelt = {word.casefold(): word for word in words}
        if isinstance(written, str) and written.casefold() in spelt:
            return spelt[written.casefold()]
        self._reject(key, f"is none of {', '.join(words)}", one_of(words, str(written)))
        return words[0]

    def _action_space(self, space_type: str) -> ActionSpace:
        if "action_space" not in self._file.values:
            self._findings.append(
                Finding(
                    self._file.name,
                    "action_space is missing",
                    'Add a list such as "action_space": [{"steering_angle": 0, "speed": 1.0}].',
                )
            )
            return ActionSpace()
        reader = ActionSpaceReader(self._file, self._findings, self._notes)
        written = self._file.values["action_space"]
        if space_type == "continuous":
            return reader.continuous(written)
        return reader.discrete(written)

    def _version(self) -> str:
        default = "2.0" if "sensor" in self._file.values else "1.0"
        written = self._file.values.get("version", default)
        try:
            fits = not isinstance(written, bool) and float(written) in VERSIONS
        except (TypeError, ValueError, OverflowError):
            fits = False
        if fits:
            return str(written).strip()
        self._reject("version", "is no version from 1 to 6", 'Write "version": "5".')
        return default

    def _sensor(self, version: float) -> tuple[str, ...]:
        names = self._file.values.get("sensor", ["observation"])
        known = (*CAMERAS, *LIDARS)
        if not isinstance(names, list) or not names:
            self._reject("sensor", "is no list of sensors", 'Write ["FRONT_FACING_CAMERA"].')
            return ("observation",)
        unknown = [name for name in names if name not in known]
        if unknown:
            word = str(unknown[0])
            self._reject("sensor", f"holds {shown(word)}, which is no sensor", one_of(known, word))
            return ("observation",)
        cameras = [name for name in names if name in CAMERAS]
        lidars = [name for name in names if name in LIDARS]
        if len(cameras) != 1:
            problem = "holds no camera" if not cameras else "holds more than one camera"
            self._reject("sensor", problem, f"Keep exactly one of {', '.join(CAMERAS)}.")
        if len(lidars) > 1:
            self._reject(
                "sensor", "holds more than one lidar", f"Keep at most one of {', '.join(LIDARS)}."
            )
        if version < 2 and "sensor" in self._file.values and names != ["observation"]:
            what = f"version {version:g} has one camera; its sensor list is ignored"
            remedy = 'Write "version": "5", or remove the sensors.'
            self._notes.append(Finding(self._file.where("sensor"), what, remedy))
            return ("observation",)
        return tuple(names)

    def _lidar_config(self) -> LidarConfig:
        config = self._file.values.get("lidar_config", {})
        if not isinstance(config, dict):
            remedy = 'Write {"num_sectors": 8, "num_values_per_sector": 8, "clipping_dist": 2.0}.'
            self._reject("lidar_config", "is no object", remedy)
            return LidarConfig()
        rules: dict[str, tuple[Callable[[float], bool], str]] = {
            "num_sectors": (
                lambda n: n > 0 and n % 1 == 0 and 64 % n == 0,
                "Write a divisor of 64, such as 8.",
            ),
            "num_values_per_sector": (lambda n: n >= 1 and n % 1 == 0, "Write a whole number."),
            "clipping_dist": (lambda n: 0.15 <= n <= 12.0, "Write metres from 0.15 to 12."),
        }
        for key, (fits, remedy) in rules.items():
            number: Any = config.get(key)
            real = isinstance(number, int | float) and not isinstance(number, bool)
            if key in config and not (real and fits(number)):
                what = f"lidar_config.{key}={as_written(number)} does not fit"
                where = self._file.where("lidar_config", key)
                self._findings.append(Finding(where, what, remedy))
        if self._findings:
            return LidarConfig()
        return LidarConfig(**{key: config[key] for key in rules if key in config})

    def _reject(self, key: str, problem: str, remedy: str) -> None:
        written: Any = self._file.values.get(key)
        what = f"{key}={as_written(written)} {problem}"
        self._findings.append(Finding(self._file.where(key), what, remedy))
