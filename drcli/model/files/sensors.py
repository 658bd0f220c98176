"""The sensors that model_metadata.json may name; `drsim.sensing.sensors` computes what they see."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Sensor:
    """A name in model_metadata.json.

    Attributes:
        words: For people.
        eyes: Pictures; 0 for a lidar.
        values: Of a lidar; 0 where `lidar_config` divides the rays.
        alias_of: The usual name of the same sensor.
        on_car: Whether the physical car knows it.
    """

    words: str
    eyes: int = 0
    values: int = 0
    alias_of: str = ""
    on_car: bool = True


SENSORS: Mapping[str, Sensor] = MappingProxyType(
    {
        "FRONT_FACING_CAMERA": Sensor("one camera to the front", eyes=1),
        "observation": Sensor("one camera (old name)", eyes=1, alias_of="FRONT_FACING_CAMERA"),
        "LEFT_CAMERA": Sensor("one camera (old name)", eyes=1, alias_of="FRONT_FACING_CAMERA"),
        "STEREO_CAMERAS": Sensor("two cameras, side by side", eyes=2),
        "LIDAR": Sensor("lidar, 64 distances", values=64),
        "SECTOR_LIDAR": Sensor("lidar, 8 sectors", values=8),
        "DISCRETIZED_SECTOR_LIDAR": Sensor("lidar, sectors in steps", on_car=False),
    }
)

CAMERAS = tuple(name for name, sensor in SENSORS.items() if sensor.eyes)
LIDARS = tuple(name for name, sensor in SENSORS.items() if not sensor.eyes)
CONFIGURED_LIDARS = tuple(name for name in LIDARS if not SENSORS[name].values)
"""Those that `lidar_config` describes."""


def eyes_of(names: Iterable[str]) -> int:
    return max(SENSORS[name].eyes for name in names)


def usual_names(names: Iterable[str]) -> list[str]:
    """Several names mean the same grey picture; the lidar last."""
    usual = [SENSORS[name].alias_of or name for name in names]
    return sorted(usual, key=lambda name: name in LIDARS)
