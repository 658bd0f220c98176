"""Checks archives before they are sent: the car names no reasons."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.problems import refuse
from drcli.formats.archive import read_packed
from drcli.formats.car_archive import check_car_archive
from drcli.formats.car_rules import END


@dataclass(frozen=True)
class CarFile:
    """Checked."""

    path: Path
    name: str
    sensors: tuple[str, ...]


def check_file(path: Path) -> CarFile:
    """Read an archive; SettingsError if the car would not take it."""
    check = check_car_archive(read_packed(path), str(path))
    refuse(check.problems)
    return CarFile(path, path.name.removesuffix(END), check.sensors)
