"""training_params.yaml and evaluation_params.yaml, for tools and people; we never read them."""

from typing import Any

import yaml

from drcli.config.settings import Settings
from drcli.store import keys


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
