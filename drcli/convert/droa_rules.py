"""Checks a model by the rules of DeepRacer on AWS, whose answers are general.

Source: deepracer-on-aws, its import page, importModel.ts, validation.ts and ImportHelper.ts of
November 2026.
"""

import ast
import json
import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from drcli.base.errors import Problem, SettingsError, Severity, closest, shown
from drcli.model import keys
from drcli.model.files.params_yaml import (
    CLOCKWISE,
    COLORS,
    DEEPRACER_COLORS,
    DEEPRACER_SHELL,
    DROA_TRACKS,
    SHELLS,
    read_parameters,
    split_world,
)

# Checks training_params.yaml before an import.


MOST_BYTES = 1024**3
MOST_FILES = 1_000
"""The importer reads one page of a list."""

FILE = "training_params.yaml"

MOST_OBSTACLES = 6
FIRST_OBSTACLE, LAST_OBSTACLE = 0.07, 0.90
"""Of the lap."""
LEAST_GAP = 0.13
_ROUNDING = 1e-9


def race_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    """Race and car; `track_problems` are those of the track."""
    yield from _car(values)
    race = values.get("RACE_TYPE")
    if race == "OBJECT_AVOIDANCE":
        yield from _obstacles(values)
    elif race not in (None, "TIME_TRIAL"):
        yield problem(
            FILE,
            f"RACE_TYPE={shown(str(race))} is imported as TIME_TRIAL.",
            "Write TIME_TRIAL or OBJECT_AVOIDANCE.",
            "warning",
        )


def track_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    world = str(values.get("WORLD_NAME") or "")
    track, named = split_world(world)
    if named is not None and track in DROA_TRACKS:
        yield problem(
            FILE,
            f"WORLD_NAME={world} names a direction; DeepRacer on AWS knows the track as {track}.",
            f"Write WORLD_NAME: {track} and TRACK_DIRECTION_CLOCKWISE: "
            f"{'true' if named == CLOCKWISE else 'false'}.",
        )
        return
    if world not in DROA_TRACKS:
        likely = closest(world, DROA_TRACKS)
        yield problem(
            FILE,
            f"WORLD_NAME={shown(world) or '(empty)'} is not a track of DeepRacer on AWS, which "
            f"has {len(DROA_TRACKS)}.",
            f"Write {likely}." if likely else "Write a track that it has, such as reinvent_base.",
        )
        return
    directions = DROA_TRACKS[world]
    clockwise = values.get("TRACK_DIRECTION_CLOCKWISE")
    if len(directions) == 1:
        if isinstance(clockwise, bool) and clockwise != (directions[0] == CLOCKWISE):
            yield problem(
                FILE,
                f"{world} can only be driven {_words(directions[0])} there; "
                f"TRACK_DIRECTION_CLOCKWISE={str(clockwise).lower()} is ignored.",
                "Expect the model to be evaluated the other way around.",
                "warning",
            )
    elif clockwise is None:
        yield problem(
            FILE,
            f"TRACK_DIRECTION_CLOCKWISE is missing; {world} would be driven counterclockwise.",
            "Write TRACK_DIRECTION_CLOCKWISE: true or false, without quotes.",
        )
    elif not isinstance(clockwise, bool):
        yield problem(
            FILE,
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
            yield problem(
                FILE,
                f"CAR_COLOR={shown(str(color))} does not exist for the shell {shell}.",
                f"Write one of {known}.",
            )
        elif upper and upper not in COLORS:
            yield problem(
                FILE,
                f"CAR_COLOR={shown(str(color))} is unknown; the car will be white.",
                "Write a colour such as Red.",
                "warning",
            )
    elif shell and shell not in SHELLS:
        yield problem(
            FILE,
            f"BODY_SHELL_TYPE={shown(str(shell))} is unknown; the car will be a white deepracer.",
            "Write a shell that it has, such as deepracer.",
            "warning",
        )


def _obstacles(values: Mapping[str, Any]) -> Iterator[Problem]:
    number = values.get("NUMBER_OF_OBSTACLES")
    if not isinstance(number, int) or isinstance(number, bool):
        yield problem(
            FILE,
            f"NUMBER_OF_OBSTACLES={shown(str(number))} is not a whole number without quotes.",
            f"Write a number from 1 to {MOST_OBSTACLES}.",
        )
        return
    if not 1 <= number <= MOST_OBSTACLES:
        yield problem(
            FILE,
            f"NUMBER_OF_OBSTACLES={number} is not from 1 to {MOST_OBSTACLES}.",
            f"Write a number from 1 to {MOST_OBSTACLES}.",
        )
    positions = values.get("OBJECT_POSITIONS")
    if not positions or values.get("RANDOMIZE_OBSTACLE_LOCATIONS") is True:
        return
    places = _places(positions)
    if places is None:
        yield problem(
            FILE,
            "OBJECT_POSITIONS is not a list of texts such as '0.25,1'.",
            "Write a part of the lap and a lane, 1 or -1, for each obstacle.",
        )
        return
    if len(places) != number:
        yield problem(
            FILE,
            f"There are {len(places)} OBJECT_POSITIONS, but NUMBER_OF_OBSTACLES={number}.",
            "Make both equal.",
        )
    places.sort()
    gaps = [after - before for before, after in pairwise(places)]
    if places[0] < FIRST_OBSTACLE or places[-1] > LAST_OBSTACLE:
        yield problem(
            FILE,
            f"Obstacles stand from {places[0]:g} to {places[-1]:g} of the lap; they must stand "
            f"from {FIRST_OBSTACLE} to {LAST_OBSTACLE:g}.",
            "Move them in OBJECT_POSITIONS.",
        )
    if gaps and min(gaps) < LEAST_GAP - _ROUNDING:
        yield problem(
            FILE,
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


NAME_RULE = re.compile(r"[a-zA-Z0-9-]{1,64}")
DESCRIPTION_RULE = re.compile(r"[a-zA-Z0-9 -]{1,255}")

RULE = "droa"

ROOT_FILES = ("model_metadata.json", "reward_function.py", "training_params.yaml")
HYPERPARAMETERS = "ip/hyperparameters.json"
POINTER = "model/.coach_checkpoint"
INDEX = "model/deepracer_checkpoints.json"

LARGEST_PARAMETERS_BYTES = 10 * 1024**2
LONGEST_REWARD = 140_000
_IMPORTS = frozenset({"math", "random", "numpy", "scipy", "shapely"})
_CHECKPOINT = re.compile(r"\d+_Step-\d+\.ckpt")
_LOSSES = ("huber", "mean_squared_error")
_EXPLORATIONS = ("categorical", "e-greedy")


def check_name(name: str) -> None:
    if not NAME_RULE.fullmatch(name):
        usable = re.sub(r"[^a-zA-Z0-9]+", "-", name).strip("-")[:64].strip("-")
        raise SettingsError(
            f"'{shown(name)}' cannot be the name of a model: 1 to 64 letters, digits and hyphens.",
            remedy=f"Give --model-name {usable or 'my-model'}.",
        )


def check_description(description: str) -> None:
    if description and not DESCRIPTION_RULE.fullmatch(description):
        raise SettingsError(
            f"'{shown(description)}' cannot be a description: up to 255 letters, digits, spaces "
            "and hyphens.",
            remedy="Shorten it, and leave out other characters, full stops too.",
        )


def package_problems(files: Mapping[str, bytes]) -> list[Problem]:
    """What it would refuse (errors) or lose (warnings)."""
    return [*_layout(files), *_checkpoint(files), *content_problems(files)]


def problem(file: str, message: str, remedy: str, severity: Severity = "error") -> Problem:
    return Problem(RULE, severity, file, None, message, remedy)


def _layout(files: Mapping[str, bytes]) -> Iterator[Problem]:
    export = "Use `dr-export droa`, which writes every file to its place."
    if any(name.endswith(".pb") for name in files) and not any("ckpt" in name for name in files):
        yield problem(
            "",
            "This is an archive for the car: it has a frozen graph and no checkpoint, and cannot "
            "be imported.",
            "Import the model itself.",
        )
        return
    for name in (*ROOT_FILES, HYPERPARAMETERS):
        if name in files:
            if not files[name].strip():
                yield problem(name, f"{name} is empty.", export)
            continue
        elsewhere = [each for each in files if each.rpartition("/")[2] == name.rpartition("/")[2]]
        where = f"; {elsewhere[0]} is not read" if elsewhere else ""
        yield problem(name, f"{name} is missing{where}.", export)
    total = sum(map(len, files.values()))
    if total >= MOST_BYTES:
        yield problem(
            "",
            f"The files have {total / 1e9:.2f} GB together; less than 1.07 GB can be imported.",
            "Leave out logs, videos and older checkpoints.",
        )
    if len(files) > MOST_FILES:
        yield problem(
            "",
            f"There are {len(files):,} files; only the first {MOST_FILES:,} would be imported.",
            "Leave out logs, traces and older checkpoints.",
        )
    metrics = [n for n in files if n.startswith("metrics/training/") and n.endswith(".json")]
    if not any("training-" in name for name in metrics):
        yield problem(
            "metrics/training/",
            "There is no metrics/training/training-*.json, so the model will have no reward graph.",
            export,
            "warning",
        )


def _checkpoint(files: Mapping[str, bytes]) -> Iterator[Problem]:
    export = "Use `dr-export droa`, which writes a TensorFlow checkpoint."
    in_model = [name.removeprefix("model/") for name in files if name.startswith("model/")]
    if not any(".ckpt." in name and not name.endswith(".pb") for name in in_model):
        yield problem("model/", "There is no checkpoint in the folder model/.", export)
        return
    if all(name.endswith((".safetensors", ".json")) for name in in_model if ".ckpt." in name):
        yield problem(
            "model/",
            "The checkpoints in model/ are in drcli's own format; DeepRacer on AWS needs a "
            "TensorFlow checkpoint.",
            export,
        )
        return
    if POINTER not in files:
        yield problem(POINTER, f"{POINTER} is missing, which names the checkpoint.", export)
    named = {}
    if POINTER in files:
        named[POINTER] = [files[POINTER].decode("utf-8", "replace").strip()]
    if INDEX in files:
        named[INDEX] = list(_indexed(files[INDEX]))
    for file, names in named.items():
        for name in dict.fromkeys(names):
            yield from _parts(files, file, name, export)


def _parts(files: Mapping[str, bytes], file: str, name: str, remedy: str) -> Iterator[Problem]:
    if not _CHECKPOINT.fullmatch(name):
        yield problem(
            file, f"{file} names '{shown(name)}', not a checkpoint as 30_Step-9000.ckpt.", remedy
        )
        return
    for end in keys.TENSORFLOW_PARTS:
        part = f"model/{name}{end}"
        if not files.get(part):
            state = "is empty" if part in files else "is missing"
            yield problem(part, f"{part} {state}; {file} names that checkpoint.", remedy)


def _indexed(data: bytes) -> Iterator[str]:
    values, _ = _json(data)
    for entry in (values or {}).values():
        if isinstance(entry, dict) and "name" in entry:
            yield str(entry["name"])


def content_problems(files: Mapping[str, bytes]) -> Iterator[Problem]:
    """Of those files that are there, which a training has before its first checkpoint."""
    objects: dict[str, dict[str, Any]] = {}
    for name in ("model_metadata.json", HYPERPARAMETERS):
        if files.get(name, b"").strip():
            values, reason = _json(files[name])
            if values is None:
                yield problem(name, f"{name} cannot be read: {reason}.", "Correct that file.")
            else:
                objects[name] = values
    metadata = objects.get("model_metadata.json")
    hyperparameters = objects.get(HYPERPARAMETERS)
    if metadata is not None:
        yield from _actions(metadata)
        yield from _algorithm(metadata, hyperparameters)
    if hyperparameters is not None:
        yield from _shown_values(hyperparameters)
    parameters = files.get("training_params.yaml", b"")
    if len(parameters) > LARGEST_PARAMETERS_BYTES:
        yield problem(
            "training_params.yaml",
            f"training_params.yaml has {len(parameters) / 1e6:.1f} MB; at most 10 MB are allowed.",
            "Keep only the settings of the training.",
        )
    elif parameters.strip():
        try:
            values = read_parameters(parameters)
        except ValueError as e:
            remedy = "Correct that file."
            yield problem("training_params.yaml", f"It cannot be read: {e}.", remedy)
        else:
            yield from track_problems(values)
            yield from race_problems(values)
    if files.get("reward_function.py", b"").strip():
        yield from _reward(files["reward_function.py"])


def _json(data: bytes) -> tuple[dict[str, Any] | None, str]:
    try:
        values = json.loads(data)
    except json.JSONDecodeError as e:
        return None, f"it is not JSON (line {e.lineno})"
    except (ValueError, RecursionError):
        return None, "it is not JSON"
    return (values, "") if isinstance(values, dict) else (None, "it is not a JSON object")


def _actions(metadata: Mapping[str, Any]) -> Iterator[Problem]:
    file = "model_metadata.json"
    space = metadata.get("action_space")
    if isinstance(space, list):
        complete = [
            a for a in space if isinstance(a, dict) and {"speed", "steering_angle"} <= a.keys()
        ]
        if not space or len(complete) < len(space):
            yield problem(file, "An action lacks speed or steering_angle.", "Correct action_space.")
        return
    if not isinstance(space, dict):
        yield problem(file, "action_space is missing.", "Write the actions of the model.")
        return
    for key in ("speed", "steering_angle"):
        limits = space.get(key)
        low, high = (limits.get(k) if isinstance(limits, dict) else None for k in ("low", "high"))
        numbers = [v for v in (low, high) if isinstance(v, int | float) and v is not True]
        if len(numbers) < 2:
            yield problem(file, f"{key} has no low and high.", "Correct action_space.")
        elif numbers[0] >= numbers[1]:
            yield problem(
                file,
                f"{key} has low={low} and high={high}; low must be less than high.",
                "Correct action_space.",
            )


def _algorithm(
    metadata: Mapping[str, Any], hyperparameters: Mapping[str, Any] | None
) -> Iterator[Problem]:
    if metadata.get("training_algorithm") != "sac":
        return
    discrete = metadata.get("action_space_type") == "discrete"
    if discrete or isinstance(metadata.get("action_space"), list):
        yield problem(
            "model_metadata.json",
            "training_algorithm=sac needs continuous actions; these are discrete.",
            "Import a model with ranges of actions.",
        )
    episodes = (hyperparameters or {}).get("num_episodes_between_training", 1)
    if hyperparameters is not None and (episodes != 1 or episodes is True):
        yield problem(
            HYPERPARAMETERS,
            f"num_episodes_between_training={shown(str(episodes))}; with sac only 1 is accepted.",
            f"Set it to 1 in {HYPERPARAMETERS}; it does not change the trained model.",
        )


def _shown_values(hyperparameters: Mapping[str, Any]) -> Iterator[Problem]:
    for key, known in (("loss_type", _LOSSES), ("exploration_type", _EXPLORATIONS)):
        value = hyperparameters.get(key)
        if value is not None and value not in known:
            yield problem(
                HYPERPARAMETERS,
                f"{key}={shown(str(value))} is unknown to DeepRacer on AWS.",
                f"Write one of {', '.join(known)}.",
                "warning",
            )


def _reward(data: bytes) -> Iterator[Problem]:
    file = "reward_function.py"
    text = data.decode("utf-8", "replace")
    if len(text) > LONGEST_REWARD:
        yield problem(
            file,
            f"The reward function has {len(text):,} characters; at most {LONGEST_REWARD:,} are "
            "allowed.",
            "Shorten it, for example by rounding the numbers of a racing line.",
        )
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as e:
        where = f" in line {e.lineno}" if isinstance(e, SyntaxError) and e.lineno else ""
        yield problem(file, f"The reward function is not Python{where}.", "Correct that file.")
        return
    if not any(isinstance(n, ast.FunctionDef) and n.name == "reward_function" for n in tree.body):
        yield problem(file, "There is no function reward_function.", "Correct that file.")
    imported = {name.partition(".")[0] for node in ast.walk(tree) for name in _imported(node)}
    for name in sorted(imported - _IMPORTS):
        yield problem(
            file,
            f"The reward function imports {shown(name)}, which DeepRacer on AWS does not allow.",
            f"Use only {', '.join(sorted(_IMPORTS))}.",
        )


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module or "."] if isinstance(node, ast.ImportFrom) else []
