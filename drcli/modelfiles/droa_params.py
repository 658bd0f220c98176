"""training_params.yaml as DeepRacer on AWS reads it: typed, so the text 'true' is not true."""

import re
from collections.abc import Mapping
from typing import Any, Literal

import yaml

Direction = Literal["CLOCKWISE", "COUNTER_CLOCKWISE"]

CLOCKWISE: Direction = "CLOCKWISE"
COUNTER_CLOCKWISE: Direction = "COUNTER_CLOCKWISE"

_BOTH = """
2022_april_open 2022_april_pro 2022_august_open 2022_august_pro 2022_july_pro 2022_june_open
2022_june_pro 2022_march_open 2022_march_pro 2022_may_open 2022_may_pro 2022_october_open
2022_october_pro 2022_reinvent_champ 2022_september_open 2022_september_pro 2022_summit_speedway
2024_reinvent_champ arctic_open arctic_pro dubai_open jyllandsringen_open jyllandsringen_pro
penbay_open penbay_pro red_star_pro reInvent2019_track reInvent2019_wide thunder_hill_pro
"""
_CLOCKWISE_ONLY = """
Albert Aragon Belille FS_June2020 July_2020 Monaco Monaco_building Spain_track
"""
_COUNTER_CLOCKWISE_ONLY = """
2022_july_open AmericasGeneratedInclStart Austin Bowtie_track caecer_gp caecer_loop Canada_Training
China_track dubai_pro hamption_open hamption_pro LGSWide Mexico_track morgan_open morgan_pro
New_York_Track Oval_track red_star_open reinvent_base Singapore Singapore_building
thunder_hill_open Tokyo_Training_track Vegas_track Virtual_May19_Train_track
"""

DROA_TRACKS: Mapping[str, tuple[Direction, ...]] = {
    **dict.fromkeys(_BOTH.split(), (CLOCKWISE, COUNTER_CLOCKWISE)),
    **dict.fromkeys(_CLOCKWISE_ONLY.split(), (CLOCKWISE,)),
    **dict.fromkeys(_COUNTER_CLOCKWISE_ONLY.split(), (COUNTER_CLOCKWISE,)),
}
"""With directions. Source: deepracer-on-aws, libs/config, tracks.json, November 2026."""

_SUFFIX = re.compile(r"_(cw|ccw)$")

_NUMBERS = (
    "NUMBER_OF_OBSTACLES",
    "MIN_DISTANCE_BETWEEN_OBSTACLES",
    "ROUND_ROBIN_ADVANCE_DIST",
    "START_POSITION_OFFSET",
    "MIN_EVAL_TRIALS",
    "NUM_WORKERS",
)
_TRUTH_TAG = "tag:yaml.org,2002:bool"
_TRUTH = {"true": True, "false": False}


def split_world(name: str) -> tuple[str, Direction | None]:
    """Without `_cw` or `_ccw`, and the direction that it names."""
    match = _SUFFIX.search(name)
    if match is None:
        return name, None
    return name[: match.start()], CLOCKWISE if match[1] == "cw" else COUNTER_CLOCKWISE


def droa_parameters(data: bytes, route: Direction | None) -> bytes:
    """Change a parameter file of ours or DeepRacer-for-Cloud's for DeepRacer on AWS.

    Texts become numbers and truth values. TRACK_DIRECTION_CLOCKWISE comes from the track's `_cw` or
    `_ccw`, which is cut, else from `route`; REVERSE_DIR turns it around.

    Raises:
        ValueError: The data is not such a file, or nothing says the direction.
    """
    values = read_parameters(data)
    typed = {name: _typed(name, value) for name, value in values.items()}
    track, named = split_world(str(values.get("WORLD_NAME", "")))
    typed["WORLD_NAME"] = track
    directions = DROA_TRACKS.get(track, (CLOCKWISE, COUNTER_CLOCKWISE))
    if len(directions) == 1:
        typed["TRACK_DIRECTION_CLOCKWISE"] = directions[0] == CLOCKWISE
    elif named is None and "TRACK_DIRECTION_CLOCKWISE" in typed:
        pass  # somebody has said it already
    else:
        direction = named or route
        if direction is None:
            raise ValueError("it does not say in which direction the track is driven")
        backwards = typed.get("REVERSE_DIR") is True
        typed["TRACK_DIRECTION_CLOCKWISE"] = (direction == CLOCKWISE) != backwards
    text = yaml.safe_dump(typed, explicit_start=True, sort_keys=True, allow_unicode=True)
    return text.encode()


def read_parameters(data: bytes) -> dict[str, Any]:
    """By YAML 1.2, as there: `yes` and `on` are texts. Raises ValueError."""
    try:
        node = yaml.compose(data.decode("utf-8-sig"), Loader=yaml.SafeLoader)
        if node is None:
            raise ValueError("it is empty")
        if not isinstance(node, yaml.MappingNode):
            raise ValueError("it has no lines of the form NAME: value")
        for key, value in node.value:
            is_truth = isinstance(value, yaml.ScalarNode) and value.tag == _TRUTH_TAG
            if is_truth and value.value.casefold() not in _TRUTH:
                value.tag = "tag:yaml.org,2002:str"
            if not isinstance(key, yaml.ScalarNode):
                raise ValueError("it has a name that is not a text")
        constructor = yaml.SafeLoader("")
        values = {
            str(key.value): constructor.construct_object(v, deep=True) for key, v in node.value
        }
    except UnicodeDecodeError as e:
        raise ValueError("it is not UTF-8 text") from e
    except (yaml.YAMLError, RecursionError) as e:
        mark = getattr(e, "problem_mark", None)
        where = "" if mark is None else f" (line {mark.line + 1})"
        raise ValueError(f"it is not YAML{where}") from e
    return values


def _typed(name: str, value: Any) -> Any:
    if not isinstance(value, str):
        return value
    text = value.strip()
    if text.casefold() in _TRUTH:
        return _TRUTH[text.casefold()]
    if name in _NUMBERS:
        for kind in (int, float):
            try:
                return kind(text)
            except ValueError:
                continue
    return value
