"""Obstacles, bot cars and another model on the track."""

from typing import Literal

from drcli.config.checkpoint_words import OptionalCheckpointText
from drcli.config.fields import Group, setting
from drcli.config.value_types import ObjectKey, Positions

_SHELL = "videos show one shell in all colours"
_OVERLAY = "nothing shows it"


class ObstacleSettings(Group, title="Obstacles"):
    """For OBJECT_AVOIDANCE."""

    oa_number_of_obstacles: int = setting(
        "DR_OA_NUMBER_OF_OBSTACLES", 6, "Number of obstacles.", low=0
    )
    oa_min_distance_between_obstacles: float = setting(
        "DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES",
        2.0,
        "Minimum distance between two obstacles, metres.",
        low=0,
    )
    oa_randomize_obstacle_locations: bool = setting(
        "DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS", False, "Move the obstacles in each episode."
    )
    oa_is_obstacle_bot_car: bool = setting(
        "DR_OA_IS_OBSTACLE_BOT_CAR", False, "Parked cars instead of boxes."
    )
    oa_obstacle_type: Literal["box_obstacle", "deepracer_box_obstacle", "amazon_box_obstacle"] = (
        setting("DR_OA_OBSTACLE_TYPE", "box_obstacle", "Kind of box.")
    )
    oa_object_positions: Positions = setting(
        "DR_OA_OBJECT_POSITIONS",
        (),
        "Fixed positions as progress,lane pairs; they override number and randomization.",
    )
    eval_reset_behind_dist: float = setting(
        "DR_EVAL_RESET_BEHIND_DIST",
        1.0,
        "How far behind an obstacle the car continues after a collision, metres.",
        low=0,
    )


class BotSettings(Group, title="Bot cars"):
    """For HEAD_TO_BOT."""

    h2b_is_lane_change: bool = setting("DR_H2B_IS_LANE_CHANGE", False, "Let bots change lanes.")
    h2b_lower_lane_change_time: float = setting(
        "DR_H2B_LOWER_LANE_CHANGE_TIME", 3.0, "Minimum time between lane changes, seconds.", low=0
    )
    h2b_upper_lane_change_time: float = setting(
        "DR_H2B_UPPER_LANE_CHANGE_TIME", 5.0, "Maximum time between lane changes, seconds.", low=0
    )
    h2b_lane_change_distance: float = setting(
        "DR_H2B_LANE_CHANGE_DISTANCE", 1.0, "Distance driven during a lane change, metres.", low=0
    )
    h2b_number_of_bot_cars: int = setting("DR_H2B_NUMBER_OF_BOT_CARS", 3, "Number of bots.", low=0)
    h2b_min_distance_between_bot_cars: float = setting(
        "DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS",
        2.0,
        "Minimum distance between two bots, metres.",
        low=0,
    )
    h2b_randomize_bot_car_locations: bool = setting(
        "DR_H2B_RANDOMIZE_BOT_CAR_LOCATIONS", False, "Move the bots' starts in each episode."
    )
    h2b_bot_car_speed: float = setting(
        "DR_H2B_BOT_CAR_SPEED", 0.2, "Speed of the bots, m/s.", between=(0, 100)
    )
    h2b_bot_car_penalty: float = setting(
        "DR_H2B_BOT_CAR_PENALTY",
        5.0,
        "How long the bots wait after the car hit one from behind, seconds.",
        low=0,
    )


class OpponentSettings(Group, title="Opponent of HEAD_TO_MODEL"):
    """For HEAD_TO_MODEL."""

    eval_opp_s3_model_prefix: ObjectKey = setting(
        "DR_EVAL_OPP_S3_MODEL_PREFIX", "rl-deepracer-sagemaker", "Model of the opponent."
    )
    eval_opp_checkpoint: OptionalCheckpointText = setting(
        "DR_EVAL_OPP_CHECKPOINT",
        "",
        "Its checkpoint, as for DR_EVAL_CHECKPOINT; if empty, the same word or number as that.",
    )
    eval_opp_car_body_shell_type: str = setting(
        "DR_EVAL_OPP_CAR_BODY_SHELL_TYPE", "deepracer", "Body of its car.", ignored=_SHELL
    )
    eval_opp_car_name: str = setting(
        "DR_EVAL_OPP_CAR_NAME", "FasterCar", "Name of its car.", ignored=_OVERLAY
    )
    eval_opp_display_name: str = setting(
        "DR_EVAL_OPP_DISPLAY_NAME",
        "$DR_EVAL_OPP_CAR_NAME",
        "Name shown for its car.",
        ignored=_OVERLAY,
    )
    eval_opp_racer_name: str = setting(
        "DR_EVAL_OPP_RACER_NAME",
        "$DR_EVAL_OPP_CAR_NAME",
        "Name of its racer, which its videos show.",
    )
    eval_opp_s3_metrics_prefix: ObjectKey = setting(
        "DR_EVAL_OPP_S3_METRICS_PREFIX",
        "$DR_EVAL_OPP_S3_MODEL_PREFIX/metrics",
        "Folder of its metrics.",
    )
    eval_opp_model_prefix: ObjectKey = setting(
        "DR_EVAL_OPP_MODEL_PREFIX",
        "$DR_EVAL_OPP_S3_MODEL_PREFIX",
        "Folder of its videos.",
    )
