"""Track, car, episodes and evaluation."""

from pathlib import Path
from typing import Literal

from drcli.config.checkpoint_words import CheckpointText
from drcli.config.fields import Group, setting
from drcli.config.value_types import USUAL_CAR, CarName, Colour, StartOffset, WorldName

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
    race_type: Literal["TIME_TRIAL", "OBJECT_AVOIDANCE", "HEAD_TO_BOT", "HEAD_TO_MODEL"] = setting(
        "DR_RACE_TYPE", "TIME_TRIAL", "Kind of race."
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
        "Whether a start downloads a community track that is not installed; ask needs a terminal.",
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
