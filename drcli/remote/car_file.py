"""Checks an archive by the car's rules before it is sent, because the car names no reasons."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.problems import refuse
from drcli.formats.archive import read_packed
from drcli.formats.car_archive import check_car_archive
from drcli.formats.car_rules import END


@dataclass(frozen=True)
class CarFile:
    """An archive that keeps the car's rules.

    Attributes:
        name: Of the model on the car: the file's name without its end.
        sensors: That the model needs.
    """

    path: Path
    name: str
    sensors: tuple[str, ...]


def check_file(path: Path) -> CarFile:
    """Read an archive and check its name and its content; nothing is unpacked.

    Raises:
        SettingsError: It cannot be read, or the car would not take it.
    """
    check = check_car_archive(read_packed(path), str(path))
    refuse(check.problems)
    return CarFile(path, path.name.removesuffix(END), check.sensors)
