"""The race itself: track, car, training and evaluation (run.env)."""

from pathlib import Path
from typing import ClassVar, Literal

from drcli.config.fields import Group, setting
from drcli.config.value_types import Colour, Gpus, WorldName

_VIDEO = "it only shows in videos, which are not recorded here"
_FULL_SPEED = "the simulation keeps no clock: it always runs as fast as the processor can"


class RaceSettings(Group):
    """Which race, on which track, with which car."""

    title: ClassVar[str] = "Race and car"

    run_id: int = setting(
        "DR_RUN_ID", 0, "Number of the run; several numbers can run beside each other.", low=0
    )
    world_name: WorldName = setting(
        "DR_WORLD_NAME", "reinvent_base", "Track to drive on, by name or as path of a .npy file."
    )
    race_type: Literal["TIME_TRIAL", "OBJECT_AVOIDANCE", "HEAD_TO_BOT", "HEAD_TO_MODEL"] = setting(
        "DR_RACE_TYPE", "TIME_TRIAL", "Kind of race."
    )
    tracks_dir: Path | None = setting(
        "DR_TRACKS_DIR", None, "Folder with more tracks, one .npy file each; tracks/ when empty."
    )
    tracks_url: str = setting(
        "DR_TRACKS_URL",
        "https://raw.githubusercontent.com/aws-deepracer-community/deepracer-simapp/HEAD/bundle/routes",
        "Where `dr-tracks fetch` gets route files from.",
    )
    tracks_fetch: Literal["ask", "always", "never"] = setting(
        "DR_TRACKS_FETCH",
        "ask",
        "Whether a start fetches a track of the community that is not here; ask needs a terminal.",
    )
    car_name: str = setting("DR_CAR_NAME", "FastCar", "Name of the car.")
    car_body_shell_type: str = setting(
        "DR_CAR_BODY_SHELL_TYPE", "deepracer", "Body of the car.", ignored=_VIDEO
    )
    car_color: Colour = setting("DR_CAR_COLOR", "Red", "Colour of the car.", ignored=_VIDEO)
    display_name: str = setting("DR_DISPLAY_NAME", "$DR_CAR_NAME", "Name shown for the car.")
    racer_name: str = setting("DR_RACER_NAME", "$DR_CAR_NAME", "Name of the racer.")
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


class TrainSettings(Group):
    """How to train."""

    title: ClassVar[str] = "Training"

    workers: int = setting(
        "DR_WORKERS",
        1,
        "Simulation processes; analysis tools read at most 10.",
        low=1,
        high=10,
        file="system.env",
    )
    train_seed: int | None = setting(
        "DR_TRAIN_SEED",
        None,
        "Start of all random numbers; drawn at each start when empty.",
        low=0,
        high=2**32 - 1,
    )
    train_max_minutes: float = setting(
        "DR_TRAIN_MAX_MINUTES", 0.0, "Finish the training after this time; 0 never.", low=0
    )
    train_overlap: Literal["auto", "on", "off"] = setting(
        "DR_TRAIN_OVERLAP",
        "auto",
        "Drive the next iteration while the last one is learned from; auto does from 4 cores on.",
    )
    torch_precision: Literal["auto", "fp32", "bf16"] = setting(
        "DR_TORCH_PRECISION",
        "auto",
        "Arithmetic of the learner; auto takes bf16 where the processor has matrix units for it.",
        file="system.env",
    )
    sagemaker_cuda_devices: Gpus = setting(
        "DR_SAGEMAKER_CUDA_DEVICES",
        "",
        "GPUs of the learner; when empty, those that CUDA_VISIBLE_DEVICES allows.",
        file="system.env",
    )
    train_multi_config: bool = setting(
        "DR_TRAIN_MULTI_CONFIG",
        False,
        "Give worker N, from the second on, the track and race of worker-N.env.",
    )
    train_min_eval_trials: int = setting(
        "DR_TRAIN_MIN_EVAL_TRIALS",
        5,
        "Evaluation episodes of a checkpoint that is evaluated while training goes on.",
        low=0,
    )
    train_eval_share: float = setting(
        "DR_TRAIN_EVAL_SHARE",
        0.1,
        "Largest share of the time that evaluations may take; others are passed over.",
        low=0.001,
        high=1,
    )
    train_max_iterations: int = setting(
        "DR_TRAIN_MAX_ITERATIONS", 0, "Finish after so many updates of the policy; 0 never.", low=0
    )
    train_stop_reward: float | None = setting(
        "DR_TRAIN_STOP_REWARD",
        None,
        "Finish once the mean reward of the last 100 training episodes reaches this; empty never.",
    )
    train_stop_progress: float = setting(
        "DR_TRAIN_STOP_PROGRESS",
        0.0,
        "Finish once evaluations in a row reach this mean progress, percent; 0 never.",
        low=0,
        high=100,
    )
    train_stop_evaluations: int = setting(
        "DR_TRAIN_STOP_EVALUATIONS", 3, "How many evaluations in a row must reach it.", low=1
    )
    train_best_model_metric: Literal["progress", "reward", "laptime"] = setting(
        "DR_TRAIN_BEST_MODEL_METRIC",
        "progress",
        "What makes a checkpoint the best one; equal progress is decided by lap time.",
    )
    train_max_steps_per_iteration: int = setting(
        "DR_TRAIN_MAX_STEPS_PER_ITERATION",
        10_000,
        "Most steps that one update of the policy learns from.",
        low=1,
    )
    train_rtf: float | None = setting(
        "DR_TRAIN_RTF", None, "Speed of the simulated clock.", low=0, ignored=_FULL_SPEED
    )


class EpisodeSettings(Group):
    """How the training episodes of a worker begin, and how many it drives at once."""

    title: ClassVar[str] = "Training"

    train_lanes: int = setting(
        "DR_TRAIN_LANES",
        0,
        "Cars that each worker simulates side by side; 0 chooses by the processor.",
        low=0,
        high=256,
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
        low=0,
        high=1,
        old_names=("DR_TRAIN_ROUND_ROBIN_ADVANCE_DISTANCE",),
    )
    train_start_position_offset: float = setting(
        "DR_TRAIN_START_POSITION_OFFSET",
        0.0,
        "Place of the first start, as a fraction of the lap.",
        low=0,
        high=1,
    )
    train_alternate_driving_direction: bool = setting(
        "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION",
        False,
        "Turn round after every training episode.",
        old_names=("DR_ALTERNATE_DRIVING_DIRECTION",),
    )
    train_reverse_direction: bool = setting(
        "DR_TRAIN_REVERSE_DIRECTION", False, "Train against the track's own direction."
    )


class EvaluationSettings(Group):
    """How to evaluate a finished model."""

    title: ClassVar[str] = "Evaluation"

    eval_number_of_trials: int = setting(
        "DR_EVAL_NUMBER_OF_TRIALS", 3, "Laps of one long race, or separate episodes.", low=1
    )
    eval_is_continuous: bool = setting(
        "DR_EVAL_IS_CONTINUOUS", True, "Drive all laps in one race instead of separate episodes."
    )
    eval_max_resets: int = setting(
        "DR_EVAL_MAX_RESETS",
        100,
        "How often a car that left the track is put back before its episode ends.",
        low=0,
        old_names=("DR_EVAL_NUMBER_OF_RESETS",),
    )
    eval_off_track_penalty: float = setting(
        "DR_EVAL_OFF_TRACK_PENALTY",
        5.0,
        "Seconds that leaving the track costs; they count in the lap time.",
        low=0,
    )
    eval_collision_penalty: float = setting(
        "DR_EVAL_COLLISION_PENALTY",
        5.0,
        "Seconds that a collision costs; they count in the lap time.",
        low=0,
        old_names=("DR_COLLISION_PENALTY",),
    )
    eval_reset_behind_dist: float = setting(
        "DR_EVAL_RESET_BEHIND_DIST",
        1.0,
        "Metres behind an obstacle at which the car continues after a collision.",
        low=0,
    )
    eval_checkpoint: Literal["last", "best"] = setting(
        "DR_EVAL_CHECKPOINT", "last", "Checkpoint to evaluate."
    )
    eval_reverse_direction: bool = setting(
        "DR_EVAL_REVERSE_DIRECTION", False, "Evaluate against the track's own direction."
    )
    eval_save_mp4: bool = setting(
        "DR_EVAL_SAVE_MP4",
        False,
        "Keep videos of the evaluation.",
        planned="videos are not recorded",
    )
    eval_debug_reward: bool = setting(
        "DR_EVAL_DEBUG_REWARD",
        False,
        "Score evaluations with your own reward function instead of the built-in one.",
    )
    eval_rtf: float | None = setting(
        "DR_EVAL_RTF", None, "Speed of the simulated clock.", low=0, ignored=_FULL_SPEED
    )
