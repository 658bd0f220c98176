"""training_params.yaml and evaluation_params.yaml, for tools and people; we never read them."""

import re
from collections.abc import Mapping
from typing import Any, Literal

import yaml

from drcli.config.settings import Settings
from drcli.model import keys


def training_parameters(settings: Settings) -> bytes:
    s = settings
    values = {
        "JOB_TYPE": "TRAINING",
        **_common(s),
        "METRICS_S3_BUCKET": s.bucket,
        "METRICS_S3_OBJECT_KEY": keys.training_metrics(s.metrics_prefix, 0),
        "MODEL_METADATA_FILE_S3_KEY": s.model_metadata_key,
        "REWARD_FILE_S3_KEY": s.reward_key,
        "TRAINING_JOB_ARN": "arn:Dummy",
        "NUM_WORKERS": s.workers,
        "SAGEMAKER_SHARED_S3_BUCKET": s.bucket,
        "SAGEMAKER_SHARED_S3_PREFIX": s.model_prefix,
        "SIMTRACE_S3_BUCKET": s.bucket,
        "SIMTRACE_S3_PREFIX": s.model_prefix,
        "BODY_SHELL_TYPE": s.car_body_shell_type,
        "CAR_COLOR": s.car_color,
        "CAR_NAME": s.car_name,
        "DISPLAY_NAME": s.display_name,
        "RACER_NAME": s.racer_name,
        "REVERSE_DIR": s.train_reverse_direction,
        "ALTERNATE_DRIVING_DIRECTION": s.train_alternate_driving_direction,
        "CHANGE_START_POSITION": s.train_change_start_position,
        "ROUND_ROBIN_ADVANCE_DIST": s.train_round_robin_advance_dist,
        "START_POSITION_OFFSET": s.train_start_position_offset,
        "MIN_EVAL_TRIALS": s.eval_laps,
        "BEST_MODEL_METRIC": s.train_best_model_metric,
    }
    return _dump(values)


def moved_training_parameters(
    data: bytes, bucket: str, prefix: str, world: str | None = None
) -> bytes:
    """For a copy elsewhere; ValueError if it is not such a file."""
    try:
        values = yaml.safe_load(data)
    except (yaml.YAMLError, RecursionError) as e:
        mark = getattr(e, "problem_mark", None)
        where = "" if mark is None else f" (line {mark.line + 1})"
        raise ValueError(f"it is not YAML{where}") from e
    if not isinstance(values, dict):
        raise ValueError("it has no lines of the form NAME: value")
    buckets = ("METRICS_S3_BUCKET", "SAGEMAKER_SHARED_S3_BUCKET", "SIMTRACE_S3_BUCKET")
    places = {
        **dict.fromkeys(buckets, bucket),
        "METRICS_S3_OBJECT_KEY": keys.training_metrics(keys.metrics_prefix(prefix)),
        "MODEL_METADATA_FILE_S3_KEY": keys.model_metadata(prefix),
        "REWARD_FILE_S3_KEY": keys.reward_function(prefix),
        "SAGEMAKER_SHARED_S3_PREFIX": prefix,
        "SIMTRACE_S3_PREFIX": prefix,
    }
    if world is not None:
        places["WORLD_NAME"] = world
    values.pop("S3_ENDPOINT_URL", None)  # the address of the server that it was copied from
    return _dump({**values, **places})


def evaluation_parameters(
    settings: Settings, simtrace_prefix: str, metrics_key: str, opponent_metrics_key: str
) -> bytes:
    s = settings
    racers: dict[str, list[str]] = {
        "MODEL_S3_BUCKET": [s.bucket],
        "MODEL_S3_PREFIX": [s.model_prefix],
        "SIMTRACE_S3_BUCKET": [s.bucket],
        "SIMTRACE_S3_PREFIX": [simtrace_prefix],
        "METRICS_S3_BUCKET": [s.bucket],
        "METRICS_S3_OBJECT_KEY": [metrics_key],
        "BODY_SHELL_TYPE": [s.car_body_shell_type],
        "CAR_COLOR": [s.car_color],
        "DISPLAY_NAME": [s.display_name],
        "RACER_NAME": [s.racer_name],
    }
    if s.race_type == "HEAD_TO_MODEL":
        opponent = {
            "MODEL_S3_PREFIX": s.eval_opp_s3_model_prefix,
            "SIMTRACE_S3_PREFIX": s.eval_opp_s3_model_prefix,
            "METRICS_S3_OBJECT_KEY": opponent_metrics_key,
            "BODY_SHELL_TYPE": s.eval_opp_car_body_shell_type,
            "DISPLAY_NAME": s.eval_opp_display_name,
            "RACER_NAME": s.eval_opp_racer_name,
        }
        racers = {name: [*own, opponent.get(name, s.bucket)] for name, own in racers.items()}
        racers["CAR_COLOR"] = ["Purple", "Orange"]
    values = {
        "JOB_TYPE": "EVALUATION",
        **_common(s),
        **racers,
        "MP4_S3_BUCKET": [],
        "MP4_S3_OBJECT_PREFIX": [],
        "EVAL_CHECKPOINT": s.eval_checkpoint,
        "NUMBER_OF_TRIALS": s.eval_number_of_trials,
        "IS_CONTINUOUS": s.eval_is_continuous,
        "NUMBER_OF_RESETS": s.eval_max_resets,
        "OFF_TRACK_PENALTY": s.eval_off_track_penalty,
        "COLLISION_PENALTY": s.eval_collision_penalty,
        "RESET_BEHIND_DIST": s.eval_reset_behind_dist,
        "REVERSE_DIR": s.eval_reverse_direction,
    }
    return _dump(values)


def _common(s: Settings) -> dict[str, Any]:
    return {
        "AWS_REGION": s.aws_app_region,
        "KINESIS_VIDEO_STREAM_NAME": s.kinesis_stream_name,
        "ROBOMAKER_SIMULATION_JOB_ACCOUNT_ID": "Dummy",
        "RACE_TYPE": s.race_type,
        "WORLD_NAME": s.world_name,
        "ENABLE_DOMAIN_RANDOMIZATION": s.enable_domain_randomization,
        "CAMERA_MAIN_ENABLE": s.camera_main_enable,
        "CAMERA_SUB_ENABLE": s.camera_sub_enable,
        "ENABLE_EXTRA_KVS_OVERLAY": s.enable_extra_kvs_overlay,
        **_traffic(s),
    }


def _traffic(s: Settings) -> dict[str, Any]:
    """The reference takes it from the file for every race type."""
    if s.race_type == "OBJECT_AVOIDANCE":
        positions = [f"{fraction:g},{lane:g}" for fraction, lane in s.oa_object_positions]
        return {
            "NUMBER_OF_OBSTACLES": s.oa_number_of_obstacles,
            "MIN_DISTANCE_BETWEEN_OBSTACLES": s.oa_min_distance_between_obstacles,
            "RANDOMIZE_OBSTACLE_LOCATIONS": s.oa_randomize_obstacle_locations,
            "IS_OBSTACLE_BOT_CAR": s.oa_is_obstacle_bot_car,
            "OBSTACLE_TYPE": s.oa_obstacle_type,
            **({"OBJECT_POSITIONS": positions} if positions else {}),
        }
    if s.race_type == "HEAD_TO_BOT":
        return {
            "IS_LANE_CHANGE": s.h2b_is_lane_change,
            "LOWER_LANE_CHANGE_TIME": s.h2b_lower_lane_change_time,
            "UPPER_LANE_CHANGE_TIME": s.h2b_upper_lane_change_time,
            "LANE_CHANGE_DISTANCE": s.h2b_lane_change_distance,
            "NUMBER_OF_BOT_CARS": s.h2b_number_of_bot_cars,
            "MIN_DISTANCE_BETWEEN_BOT_CARS": s.h2b_min_distance_between_bot_cars,
            "RANDOMIZE_BOT_CAR_LOCATIONS": s.h2b_randomize_bot_car_locations,
            "BOT_CAR_SPEED": s.h2b_bot_car_speed,
            "PENALTY_SECONDS": s.h2b_bot_car_penalty,
        }
    return {}


def _dump(values: dict[str, Any]) -> bytes:
    """Sorted keys, all scalars single-quoted, for the reference's readers."""
    text = yaml.safe_dump(values, default_style="'", explicit_start=True, sort_keys=True)
    return text.encode()


# training_params.yaml as DeepRacer on AWS reads it: typed, so the text 'true' is not true.


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


# Shells and colours of cars in DeepRacer on AWS.


DEEPRACER_SHELL = "deepracer"
"""Its colour is a setting, CAR_COLOR."""

DEEPRACER_COLORS = frozenset({"BLACK", "BLUE", "GREY", "ORANGE", "PURPLE", "RED", "WHITE"})
"""Source, also of the lists below: deepracer-on-aws, libs/lambda, simulation.ts."""

COLORS = DEEPRACER_COLORS | frozenset(
    {"BROWN", "GOLDEN", "GOLDENPINK", "GREEN", "PINK", "SKY_BLUE", "TEAL", "YELLOW"}
)
_SHELLS = """
deepracer f1_2021 f1_amazon_van_purple_with_wheel f1_amazon_van_white_with_wheel
f1_august_bike_01_with_wheel f1_august_bike_02_with_wheel f1_baja_truck_03 f1_baja_truck_05
f1_car_banana_01 f1_car_clown_01 f1_car_mercedes_08 f1_car_retro_01 f1_car_tron_01
f1_car_tron_02 f1_car_tron_03 f1_car_tron_04 f1_car_tron_05 f1_car_tron_06 f1_car_tron_07
f1_car_tron_08 f1_car_tron_09 f1_car_tron_10 f1_december_car_01_with_wheel
f1_december_car_02_with_wheel f1_dog_van f1_dragon f1_dune_buggy_01 f1_dune_buggy_07
f1_hotrod_03 f1_july_car_01_with_wheel f1_july_car_02_with_wheel f1_july_car_03_with_wheel
f1_june_car_01 f1_june_car_02 f1_kart f1_lorry_01 f1_lunar_rover f1_mars_rover_with_wheel
f1_monster_truck_01 f1_mustang_eleanor_01 f1_mustang_eleanor_02 f1_mustang_eleanor_03
f1_nudie_orange_with_wheel f1_nudie_purple_with_wheel f1_nudie_white_with_wheel
f1_october_wagon_01_with_wheel f1_october_wagon_02_with_wheel f1_rogue_01
f1_september_bug_01_with_wheel f1_september_bug_02_with_wheel f1_snail fl_hotrod_02
"""

SHELLS = frozenset(_SHELLS.split())
"""BODY_SHELL_TYPE; all but the first imply a colour."""
