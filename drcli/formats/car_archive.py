"""The archive that the physical car loads, written and checked."""

import gzip
import io
import json
import tarfile
from dataclasses import dataclass
from pathlib import PurePath

from drcli.base.errors import SettingsError
from drcli.base.problems import Problem
from drcli.formats.archive import unpack_archive
from drcli.formats.car_actions import CarAction, action_problems, car_actions, sensor_problems
from drcli.formats.car_graph import graph_problems
from drcli.formats.car_rules import (
    GRAPH,
    METADATA,
    file_name_problems,
    member_problems,
    read_car_metadata,
)
from drcli.modelfiles.model_metadata import ModelMetadata

_LEVEL = 6
"""Weights hardly shrink, and higher levels take much longer."""


_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class CarCheck:
    """What the car makes of an archive.

    Attributes:
        problems: What it refuses (error), does differently (warning), or a note.
        actions: Empty if it cannot read them.
    """

    problems: tuple[Problem, ...]
    actions: tuple[CarAction, ...] = ()
    sensors: tuple[str, ...] = ()


def car_archive(graph: bytes, metadata: ModelMetadata) -> bytes:
    """The `.tar.gz` for a car; equal arguments give equal bytes.

    `graph` is frozen, with the reference's node names.
    """
    packed = io.BytesIO()
    with (
        gzip.GzipFile("", "wb", _LEVEL, packed, mtime=0) as file,
        tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as archive,
    ):
        for name, data in ((METADATA, car_metadata(metadata)), (GRAPH, graph)):
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return packed.getvalue()


def car_metadata(metadata: ModelMetadata) -> bytes:
    """model_metadata.json as the car reads it.

    It compares words letter by letter, reads sensors whatever the version, and refuses a
    `lidar_config` with the simulator's keys.
    """
    values = {
        "action_space": json.loads(metadata.action_space_json),
        "sensor": list(metadata.sensor),
        "neural_network": metadata.neural_network,
        "training_algorithm": metadata.training_algorithm,
        "action_space_type": metadata.action_space_type,
        "version": metadata.version,
    }
    return json.dumps(values, indent=2).encode() + b"\n"


def lint_car_archive(data: bytes, name: str) -> list[Problem]:
    """See `check_car_archive`."""
    return list(check_car_archive(data, name).problems)


def check_car_archive(data: bytes, name: str) -> CarCheck:
    """Check an archive by the rules of the car."""
    try:
        # The car looks at all of them, also at those that macOS adds.
        files = unpack_archive(io.BytesIO(data), name, wanted=lambda _: True)
    except SettingsError as error:
        return CarCheck((Problem("C-01", "error", name, None, str(error), error.remedy),))
    problems = list(file_name_problems(PurePath(name).name))
    if not data.startswith(_GZIP):
        what = "it is not compressed, but the car's web page only takes a compressed .tar.gz."
        remedy = "Compress it with `gzip`."
        problems.append(Problem("C-01", "error", name, None, what, remedy))
    problems += member_problems(files.keys(), name)
    graphs = [member for member in files if member.endswith(".pb")]
    actions: list[CarAction] = []
    sensors: tuple[str, ...] = ()
    if METADATA in files:
        place = f"{name}: {METADATA}"
        found = read_car_metadata(files[METADATA], place)
        sensors = found.sensors
        problems += [*found.problems, *sensor_problems(found.sensors, place)]
        num_actions = None
        if found.space is not None:
            num_actions = found.space.num_actions
            problems += action_problems(found.space, place)
            actions = car_actions(found.space)
        if len(graphs) == 1:
            place = f"{name}: {graphs[0]}"
            graph = files[graphs[0]]
            problems += graph_problems(graph, found.sensors, found.algorithm, num_actions, place)
    return CarCheck(tuple(problems), tuple(actions), sensors)
