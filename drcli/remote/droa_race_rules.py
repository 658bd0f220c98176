"""Checks training_params.yaml before an import."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from drcli.base.problems import Problem, Severity, closest, shown
from drcli.modelfiles.droa_params import CLOCKWISE, DROA_TRACKS, split_world
from drcli.modelfiles.droa_shells import COLORS, DEEPRACER_COLORS, DEEPRACER_SHELL, SHELLS

FILE = "training_params.yaml"

MOST_OBSTACLES = 6
FIRST_OBSTACLE, LAST_OBSTACLE = 0.07, 0.90
"""Of the lap."""
LEAST_GAP = 0.13
_ROUNDING = 1e-9


def race_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    yield from _track(values)
    yield from _car(values)
    race = values.get("RACE_TYPE")
    if race == "OBJECT_AVOIDANCE":
        yield from _obstacles(values)
    elif race not in (None, "TIME_TRIAL"):
        yield _problem(
            f"RACE_TYPE={shown(str(race))} is imported as TIME_TRIAL.",
            "Write TIME_TRIAL or OBJECT_AVOIDANCE.",
            "warning",
        )


def _problem(message: str, remedy: str, severity: Severity = "error") -> Problem:
    return Problem("droa", severity, FILE, None, message, remedy)


def _track(values: Mapping[str, Any]) -> Iterator[Problem]:
    world = str(values.get("WORLD_NAME") or "")
    track, named = split_world(world)
    if named is not None and track in DROA_TRACKS:
        yield _problem(
            f"WORLD_NAME={world} names a direction; DeepRacer on AWS knows the track as {track}.",
            f"Write WORLD_NAME: {track} and TRACK_DIRECTION_CLOCKWISE: "
            f"{'true' if named == CLOCKWISE else 'false'}.",
        )
        return
    if world not in DROA_TRACKS:
        likely = closest(world, DROA_TRACKS)
        yield _problem(
            f"WORLD_NAME={shown(world) or '(empty)'} is not a track of DeepRacer on AWS, which "
            f"has {len(DROA_TRACKS)}.",
            f"Write {likely}." if likely else "Write a track that it has, such as reinvent_base.",
        )
        return
    directions = DROA_TRACKS[world]
    clockwise = values.get("TRACK_DIRECTION_CLOCKWISE")
    if len(directions) == 1:
        if isinstance(clockwise, bool) and clockwise != (directions[0] == CLOCKWISE):
            yield _problem(
                f"{world} can only be driven {_words(directions[0])} there; "
                f"TRACK_DIRECTION_CLOCKWISE={str(clockwise).lower()} is ignored.",
                "Expect the model to be evaluated the other way around.",
                "warning",
            )
    elif clockwise is None:
        yield _problem(
            f"TRACK_DIRECTION_CLOCKWISE is missing; {world} would be driven counterclockwise.",
            "Write TRACK_DIRECTION_CLOCKWISE: true or false, without quotes.",
        )
    elif not isinstance(clockwise, bool):
        yield _problem(
            f"TRACK_DIRECTION_CLOCKWISE is the text '{shown(str(clockwise))}', which counts as "
            "false.",
            "Write true or false without quotes.",
        )


def _words(direction: str) -> str:
    return "clockwise" if direction == CLOCKWISE else "counterclockwise"


def _car(values: Mapping[str, Any]) -> Iterator[Problem]:
    shell, color = values.get("BODY_SHELL_TYPE"), values.get("CAR_COLOR")
    if shell == DEEPRACER_SHELL:
        upper = str(color or "").upper()
        if upper in COLORS and upper not in DEEPRACER_COLORS:
            known = ", ".join(sorted(each.capitalize() for each in DEEPRACER_COLORS))
            yield _problem(
                f"CAR_COLOR={shown(str(color))} does not exist for the shell {shell}.",
                f"Write one of {known}.",
            )
        elif upper and upper not in COLORS:
            yield _problem(
                f"CAR_COLOR={shown(str(color))} is unknown; the car will be white.",
                "Write a colour such as Red.",
                "warning",
            )
    elif shell and shell not in SHELLS:
        yield _problem(
            f"BODY_SHELL_TYPE={shown(str(shell))} is unknown; the car will be a white deepracer.",
            "Write a shell that it has, such as deepracer.",
            "warning",
        )


def _obstacles(values: Mapping[str, Any]) -> Iterator[Problem]:
    number = values.get("NUMBER_OF_OBSTACLES")
    if not isinstance(number, int) or isinstance(number, bool):
        yield _problem(
            f"NUMBER_OF_OBSTACLES={shown(str(number))} is not a whole number without quotes.",
            f"Write a number from 1 to {MOST_OBSTACLES}.",
        )
        return
    if not 1 <= number <= MOST_OBSTACLES:
        yield _problem(
            f"NUMBER_OF_OBSTACLES={number} is not from 1 to {MOST_OBSTACLES}.",
            f"Write a number from 1 to {MOST_OBSTACLES}.",
        )
    positions = values.get("OBJECT_POSITIONS")
    if not positions or values.get("RANDOMIZE_OBSTACLE_LOCATIONS") is True:
        return
    places = _places(positions)
    if places is None:
        yield _problem(
            "OBJECT_POSITIONS is not a list of texts such as '0.25,1'.",
            "Write a part of the lap and a lane, 1 or -1, for each obstacle.",
        )
        return
    if len(places) != number:
        yield _problem(
            f"There are {len(places)} OBJECT_POSITIONS, but NUMBER_OF_OBSTACLES={number}.",
            "Make both equal.",
        )
    places.sort()
    gaps = [after - before for before, after in pairwise(places)]
    if places[0] < FIRST_OBSTACLE or places[-1] > LAST_OBSTACLE:
        yield _problem(
            f"Obstacles stand from {places[0]:g} to {places[-1]:g} of the lap; they must stand "
            f"from {FIRST_OBSTACLE} to {LAST_OBSTACLE:g}.",
            "Move them in OBJECT_POSITIONS.",
        )
    if gaps and min(gaps) < LEAST_GAP - _ROUNDING:
        yield _problem(
            f"Two obstacles are {min(gaps):.3g} of the lap apart; it must be {LEAST_GAP}.",
            "Move them in OBJECT_POSITIONS.",
        )


def _places(positions: Any) -> list[float] | None:
    if not isinstance(positions, list):
        return None
    try:
        return [float(str(position).split(",")[0]) for position in positions]
    except ValueError:
        return None
