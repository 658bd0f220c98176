"""Track, car, episodes and evaluation."""

from pathlib import Path
from typing import Literal

from drcli.config.fields import Group, setting
from drcli.config.race_types import HEAD_TO_HEAD_HINT, OTHER_HEAD_TO_HEAD, RaceKind
from drcli.config.value_types import (
    USUAL_CAR,
    CarName,
    CheckpointText,
    Colour,
    ObjectKey,
    OptionalCheckpointText,
    Positions,
    StartOffset,
    WorldName,
)

_SHELL = "videos show one shell in all colours"
FULL_SPEED = "the simulation always runs as fast as the processor allows"


class RaceSettings(Group, title="Race and car"):
    run_id: int = setting(
        "DR_RUN_ID",
        0,
        "Number of the run; runs with different numbers can run at the same time.",
        low=0,
    )
    world_name: WorldName = setting(
        "DR_WORLD_NAME", "reinvent_base", "Track to drive on: its name, or the path of a .npy file."
    )
    race_type: RaceKind = setting(
        "DR_RACE_TYPE",
        "TIME_TRIAL",
        "Kind of race.",
        hints=dict.fromkeys(OTHER_HEAD_TO_HEAD, HEAD_TO_HEAD_HINT),
    )
    tracks_dir: Path | None = setting(
        "DR_TRACKS_DIR", None, "Folder with your own tracks, one .npy file each; tracks/ if empty."
    )
    tracks_url: str = setting(
        "DR_TRACKS_URL",
        "https://raw.githubusercontent.com/aws-deepracer-community/deepracer-simapp/HEAD/bundle/routes",
        "Address from which `dr-tracks fetch` downloads route files.",
    )
    tracks_fetch: Literal["ask", "always", "never"] = setting(
        "DR_TRACKS_FETCH",
        "ask",
        "Whether a start downloads a community track that is not installed; ask needs a terminal, "
        "except for --resume-or-start, which downloads it where nobody can be asked.",
    )
    sim_car: CarName = setting(
        "DR_SIM_CAR",
        USUAL_CAR,
        "How the simulated car drives: as in the reference's release 6, or in an earlier year.",
    )
    car_name: str = setting("DR_CAR_NAME", "FastCar", "Name of the car.")
    car_body_shell_type: str = setting(
        "DR_CAR_BODY_SHELL_TYPE", "deepracer", "Body of the car.", ignored=_SHELL
    )
    car_color: Colour = setting(
        "DR_CAR_COLOR", "Red", "Colour of the car in videos.", cosmetic=True
    )
    display_name: str = setting("DR_DISPLAY_NAME", "$DR_CAR_NAME", "Name shown for the car.")
    racer_name: str = setting(
        "DR_RACER_NAME", "$DR_CAR_NAME", "Name of the racer, which videos show."
    )
    enable_domain_randomization: bool = setting(
        "DR_ENABLE_DOMAIN_RANDOMIZATION",
        False,
        "Change lights and the colours of objects from episode to episode.",
    )
    randomize_textures: bool = setting(
        "DR_RANDOMIZE_TEXTURES",
        False,
        "Change the colours of road, lines and field too; only with domain randomization.",
    )


class EpisodeSettings(Group, title="Training"):
    train_worlds: str = setting(
        "DR_TRAIN_WORLDS",
        "",
        "Further tracks that training episodes drive: names, patterns such as 2022_*_open, and "
        "zoo:N for N generated circuits; empty for DR_WORLD_NAME alone.",
    )
    train_eval_world: str = setting(
        "DR_TRAIN_EVAL_WORLD",
        "",
        "Tracks on which checkpoints are evaluated during training and never trained, in the form "
        "of DR_TRAIN_WORLDS; empty for none.",
    )
    train_lanes: int = setting(
        "DR_TRAIN_LANES",
        0,
        "Cars that each worker simulates at the same time; 0 for automatic.",
        between=(0, 256),
        file="system.env",
    )
    physics: Literal["auto", "mujoco", "warp"] = setting(
        "DR_PHYSICS",
        "auto",
        "What moves the cars: MuJoCo on processor threads, which auto takes, or MuJoCo Warp on a "
        "CUDA GPU, which needs drcli[gpu] and pays from about 30 cars for each thread on.",
        file="system.env",
    )
    train_change_start_position: bool = setting(
        "DR_TRAIN_CHANGE_START_POSITION",
        True,
        "Start each training episode further along the track.",
        old_names=("DR_CHANGE_START_POSITION",),
    )
    train_round_robin_advance_dist: float = setting(
        "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST",
        0.05,
        "Distance from one start to the next, as a fraction of the lap.",
        between=(0, 1),
        old_names=("DR_TRAIN_ROUND_ROBIN_ADVANCE_DISTANCE",),
    )
    train_start_position_offset: float = setting(
        "DR_TRAIN_START_POSITION_OFFSET",
        0.0,
        "Position of the first start, as a fraction of the lap.",
        between=(0, 1),
    )
    train_alternate_driving_direction: bool = setting(
        "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION",
        False,
        "Change the driving direction after every training episode.",
        old_names=("DR_ALTERNATE_DRIVING_DIRECTION",),
    )
    train_reverse_direction: bool = setting(
        "DR_TRAIN_REVERSE_DIRECTION", False, "Train in the opposite direction."
    )


class EvaluationSettings(Group, title="Evaluation"):
    eval_number_of_trials: int = setting(
        "DR_EVAL_NUMBER_OF_TRIALS", 3, "Number of laps, or of separate episodes.", low=1
    )
    eval_is_continuous: bool = setting(
        "DR_EVAL_IS_CONTINUOUS", True, "Drive all laps in one race instead of separate episodes."
    )
    eval_max_resets: int = setting(
        "DR_EVAL_MAX_RESETS",
        100,
        "How often a car that left the track is put back before the episode ends.",
        low=0,
        old_names=("DR_EVAL_NUMBER_OF_RESETS",),
    )
    eval_off_track_penalty: float = setting(
        "DR_EVAL_OFF_TRACK_PENALTY",
        5.0,
        "Penalty in seconds for leaving the track; added to the lap time.",
        low=0,
    )
    eval_collision_penalty: float = setting(
        "DR_EVAL_COLLISION_PENALTY",
        5.0,
        "Penalty in seconds for a collision; added to the lap time.",
        low=0,
        old_names=("DR_COLLISION_PENALTY",),
    )
    eval_checkpoint: CheckpointText = setting(
        "DR_EVAL_CHECKPOINT",
        "last",
        "Checkpoint to evaluate: last, best, first-lap, three-laps, best-lap or a number.",
    )
    eval_reverse_direction: bool = setting(
        "DR_EVAL_REVERSE_DIRECTION", False, "Evaluate in the opposite direction."
    )
    eval_start_position: float = setting(
        "DR_EVAL_START_POSITION",
        0.0,
        "Where on the lap an evaluation starts, as a fraction of it.",
        between=(0, 1),
    )
    eval_start_offset: StartOffset = setting(
        "DR_EVAL_START_OFFSET",
        "centre",
        "Where across the track an evaluation starts: left, centre, right, or metres to the left "
        "of the centre line.",
    )
    eval_start_angle: float = setting(
        "DR_EVAL_START_ANGLE",
        0.0,
        "How far the car is turned to the left of the driving direction at its start, degrees.",
        between=(-180, 180),
    )
    eval_max_lap_seconds: float = setting(
        "DR_EVAL_MAX_LAP_SECONDS",
        600.0,
        "Time after which a lap of an evaluation is given up, simulated seconds.",
        between=(1, 36000),
    )
    eval_average_laps: int = setting(
        "DR_EVAL_AVERAGE_LAPS",
        3,
        "Number of consecutive laps of which an evaluation reports the best average time.",
        low=1,
    )
    eval_save_mp4: bool = setting(
        "DR_EVAL_SAVE_MP4",
        False,
        "Make videos of each evaluation: with map and camera, from behind, and from above.",
    )
    eval_video_size: Literal["640x480", "1280x720"] = setting(
        "DR_EVAL_VIDEO_SIZE", "640x480", "Size of these videos, pixels."
    )
    eval_debug_reward: bool = setting(
        "DR_EVAL_DEBUG_REWARD",
        False,
        "Score evaluations with your own reward function instead of the built-in one.",
    )
    eval_rtf: float | None = setting(
        "DR_EVAL_RTF", None, "Speed of the simulated clock.", low=0, ignored=FULL_SPEED
    )


# Obstacles, bot cars and another model on the track.


_OVERLAY = "nothing shows it"
LONGEST_GAP_M = 100
"""The longest lap of the community's tracks has 89.2 m."""


class ObstacleSettings(Group, title="Obstacles"):
    """For OBJECT_AVOIDANCE."""

    oa_number_of_obstacles: int = setting(
        "DR_OA_NUMBER_OF_OBSTACLES", 6, "Number of obstacles.", low=0
    )
    oa_min_distance_between_obstacles: float = setting(
        "DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES",
        2.0,
        "Minimum distance between two obstacles, metres.",
        between=(0, LONGEST_GAP_M),
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
        between=(0, LONGEST_GAP_M),
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


# Disturbances as for a real car; off by default.


class RealismSettings(Group, title="Sim-to-real extras"):
    """Drawn again for each episode."""

    sim_extras_in: Literal["both", "training", "evaluation"] = setting(
        "DR_SIM_EXTRAS_IN", "both", "Where the DR_SIM_ settings below apply."
    )
    sim_grow: bool = setting(
        "DR_SIM_GROW",
        False,
        "Begin with a quarter of the ranges below, and widen them while laps stay clean.",
    )
    sim_image_noise: float = setting(
        "DR_SIM_IMAGE_NOISE",
        0.0,
        "Noise in every pixel: standard deviation in greys of 0 to 255.",
        between=(0, 128),
    )
    sim_brightness: float = setting(
        "DR_SIM_BRIGHTNESS",
        0.0,
        "Brightness: changed by up to this fraction in each episode.",
        between=(0, 0.9),
    )
    sim_blur: float = setting(
        "DR_SIM_BLUR",
        0.0,
        "Blur: up to this standard deviation in each episode, in pixels of a row of 160.",
        between=(0, 4),
    )
    sim_glare: float = setting(
        "DR_SIM_GLARE",
        0.0,
        "Glare of a lamp or window beyond the walls: up to this strength in each episode.",
        between=(0, 1),
    )
    sim_reflections: float = setting(
        "DR_SIM_REFLECTIONS",
        0.0,
        "Lamps above the track, mirrored by the floor: up to this strength in each episode.",
        between=(0, 1),
    )
    sim_gray_overlay: float = setting(
        "DR_SIM_GRAY_OVERLAY",
        0.0,
        "Share of episodes with the gray gradient that the car can lay over its picture; 1: all.",
        between=(0, 1),
    )
    sim_camera_angle: float = setting(
        "DR_SIM_CAMERA_ANGLE",
        0.0,
        "Camera turned by up to this many degrees in roll, pitch and yaw.",
        between=(0, 20),
    )
    sim_camera_shift: float = setting(
        "DR_SIM_CAMERA_SHIFT",
        0.0,
        "Camera moved by up to this many metres forward, sideways and upwards.",
        between=(0, 0.05),
    )
    sim_latency: float = setting(
        "DR_SIM_LATENCY", 0.0, "Delay of every action, seconds.", between=(0, 0.5)
    )
    sim_latency_jitter: float = setting(
        "DR_SIM_LATENCY_JITTER",
        0.0,
        "Additional delay, drawn for each episode up to this many seconds.",
        between=(0, 0.5),
    )
    sim_friction: float = setting(
        "DR_SIM_FRICTION",
        0.0,
        "Grip: changed by up to this fraction in each episode.",
        between=(0, 0.9),
    )
    sim_mass: float = setting(
        "DR_SIM_MASS",
        0.0,
        "Mass of the car: changed by up to this fraction in each episode.",
        between=(0, 0.9),
    )
    sim_battery: float = setting(
        "DR_SIM_BATTERY",
        0.0,
        "Motor strength, as with a full or a weak battery: changed by up to this fraction.",
        between=(0, 0.9),
    )
    sim_steering_trim: float = setting(
        "DR_SIM_STEERING_TRIM",
        0.0,
        "Wheels that should stand straight point up to this many degrees to the left or right.",
        between=(0, 15),
    )
    sim_steering_lock: float = setting(
        "DR_SIM_STEERING_LOCK",
        0.0,
        "How far the wheels turn to the left and to the right: changed by up to this fraction.",
        between=(0, 0.9),
    )


class OwnCarSettings(Group, title="Your car"):
    """Measured on your own car; used in every episode."""

    car_steering_left: float = setting(
        "DR_CAR_STEERING_LEFT",
        30.0,
        "Degrees that the wheels turn to the left at most; smaller angles are scaled with it.",
        between=(5, 45),
    )
    car_steering_right: float = setting(
        "DR_CAR_STEERING_RIGHT",
        30.0,
        "Degrees that the wheels turn to the right at most; smaller angles are scaled with it.",
        between=(5, 45),
    )
    car_steering_trim: float = setting(
        "DR_CAR_STEERING_TRIM",
        0.0,
        "Degrees to the left (right if negative) at which wheels stand that should stand straight.",
        between=(-15, 15),
    )
    car_max_speed: float = setting(
        "DR_CAR_MAX_SPEED",
        4.0,
        "Top speed of the car in m/s; it drives no faster, whatever the action says.",
        between=(0.2, 4),
    )
    car_battery: float = setting(
        "DR_CAR_BATTERY",
        1.0,
        "Motor strength: factor on the speed that an action reaches, and on the torque.",
        between=(0.2, 1.5),
    )
