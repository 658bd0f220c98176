"""How a training goes."""

from typing import Literal

from drcli.config.fields import Group, setting
from drcli.config.groups.race import FULL_SPEED
from drcli.config.value_types import Gpus, OptionalWorldName


class TrainSettings(Group, title="Training"):
    workers: int = setting(
        "DR_WORKERS",
        1,
        "Number of simulation processes, here or with DR_LAUNCHER=ray in the cluster; "
        "deepracer-utils reads the first 10. With 0, all join from elsewhere (`dr-start-worker`).",
        between=(0, 1000),
        file="system.env",
    )
    train_seed: int | None = setting(
        "DR_TRAIN_SEED",
        None,
        "Seed of all random numbers; if empty, each start draws one.",
        between=(0, 2**32 - 1),
    )
    train_max_minutes: float = setting(
        "DR_TRAIN_MAX_MINUTES",
        0.0,
        "Finish the training after this many minutes; 0 for no limit.",
        low=0,
    )
    train_overlap: Literal["auto", "on", "off"] = setting(
        "DR_TRAIN_OVERLAP",
        "auto",
        "Drive the next iteration while the trainer learns; auto: with 4 or more cores, or with "
        "DR_TRAIN_MAX_LAG above 1.",
    )
    train_max_lag: int = setting(
        "DR_TRAIN_MAX_LAG",
        1,
        "How many checkpoints older than the newest the weights may be that drove an iteration. "
        "More than 1 lets workers drive on while the trainer waits for the slowest of them.",
        between=(1, 4),
    )
    train_shares: Literal["auto", "equal"] = setting(
        "DR_TRAIN_SHARES",
        "auto",
        "How workers share episodes once some have joined with `dr-start-worker`: equally, or "
        "slower workers less; equal for trainings that must repeat exactly.",
    )
    launcher: Literal["local", "ray"] = setting(
        "DR_LAUNCHER",
        "local",
        "Who starts the workers: this machine, or Ray on a cluster (docs/ray.md).",
        file="system.env",
    )
    ray_address: str = setting(
        "DR_RAY_ADDRESS",
        "",
        "Address of the Ray cluster; if empty, RAY_ADDRESS, and without it Ray starts here.",
        file="system.env",
    )
    ray_trainer: Literal["auto", "here", "cluster", "gpu"] = setting(
        "DR_RAY_TRAINER",
        "auto",
        "Where the trainer runs with DR_LAUNCHER=ray: here; in the cluster, on a GPU if there is "
        "one; only on a GPU; auto: in the cluster if it has a GPU and this machine has none.",
        file="system.env",
    )
    torch_precision: Literal["auto", "fp32", "bf16"] = setting(
        "DR_TORCH_PRECISION",
        "auto",
        "Number format of the trainer; auto uses bf16 if the processor has instructions for it.",
        file="system.env",
    )
    worker_device: Literal["auto", "cpu", "gpu"] = setting(
        "DR_WORKER_DEVICE",
        "auto",
        "Where simulation workers compute cameras and policy; auto uses a GPU if there is one and "
        "the extra gpu is installed.",
        file="system.env",
    )
    robomaker_cuda_devices: Gpus = setting(
        "DR_ROBOMAKER_CUDA_DEVICES",
        "",
        "GPUs of the simulation workers; if empty, those that CUDA_VISIBLE_DEVICES allows.",
        file="system.env",
    )
    train_learners: int = setting(
        "DR_TRAIN_LEARNERS",
        1,
        "Processes of the trainer, which divide each minibatch: one for each GPU, or each with "
        "its share of the cores.",
        between=(1, 64),
        file="system.env",
    )
    sagemaker_cuda_devices: Gpus = setting(
        "DR_SAGEMAKER_CUDA_DEVICES",
        "",
        "GPUs of the trainer; if empty, those that CUDA_VISIBLE_DEVICES allows.",
        file="system.env",
    )
    train_multi_config: bool = setting(
        "DR_TRAIN_MULTI_CONFIG",
        False,
        "Read the track and race of the second and all further workers from worker-N.env.",
    )
    train_eval_laps: int | None = setting(
        "DR_TRAIN_EVAL_LAPS",
        None,
        "Laps that each checkpoint drives in its evaluation during training; if empty, as many as "
        "DR_TRAIN_MIN_EVAL_TRIALS says.",
        between=(1, 1000),
    )
    train_min_eval_trials: int = setting(
        "DR_TRAIN_MIN_EVAL_TRIALS",
        20,
        "The same in folders of DeepRacer-for-Cloud, where a file does not set DR_TRAIN_EVAL_LAPS.",
        low=0,
    )
    train_eval_share: float = setting(
        "DR_TRAIN_EVAL_SHARE",
        0.05,
        "Largest share of the time that evaluations may take; evaluations beyond that are skipped.",
        between=(0.001, 1),
    )
    train_traces_max_mb: int = setting(
        "DR_TRAIN_TRACES_MAX_MB",
        4096,
        "Largest size of the training traces of a model in the bucket; 0 for no limit. Beyond it, "
        "every second of the older traces is deleted.",
        low=0,
    )
    train_keep_milestones: bool = setting(
        "DR_TRAIN_KEEP_MILESTONES",
        True,
        "Keep the checkpoints of the first evaluation lap, of the first three laps in one "
        "evaluation, and of the fastest lap.",
    )
    train_keep_every: int = setting(
        "DR_TRAIN_KEEP_EVERY",
        0,
        "Also keep every n-th checkpoint; 0 for none.",
        low=0,
    )
    train_keep_max_mb: int = setting(
        "DR_TRAIN_KEEP_MAX_MB",
        2000,
        "Largest size of milestones and every n-th checkpoint; 0 for no limit. Beyond it, some of "
        "every n-th go first, then the first lap, the three laps, and the fastest lap.",
        low=0,
    )
    train_max_iterations: int = setting(
        "DR_TRAIN_MAX_ITERATIONS",
        0,
        "Finish after this many updates of the policy; 0 for no limit.",
        low=0,
    )
    train_max_episodes: int = setting(
        "DR_TRAIN_MAX_EPISODES",
        0,
        "Finish after this many training episodes; 0 for no limit.",
        low=0,
    )
    train_max_steps: int = setting(
        "DR_TRAIN_MAX_STEPS",
        0,
        "Finish after this many steps learned from; 0 for no limit.",
        low=0,
    )
    train_stop_mean_score: float | None = setting(
        "DR_TRAIN_STOP_MEAN_SCORE",
        None,
        "Finish when the mean reward of the last DR_TRAIN_STOP_SCORE_EPISODES training episodes "
        "reaches this; empty for no limit.",
        old_names=("DR_TRAIN_STOP_REWARD",),
    )
    train_stop_score_episodes: int = setting(
        "DR_TRAIN_STOP_SCORE_EPISODES",
        100,
        "Number of training episodes over which DR_TRAIN_STOP_MEAN_SCORE takes the mean.",
        between=(1, 10_000),
    )
    train_stop_lap_time: float = setting(
        "DR_TRAIN_STOP_LAP_TIME",
        0.0,
        "Finish when all evaluation laps of a checkpoint are completed, in this many seconds or "
        "less on average; 0 for no limit.",
        low=0,
    )
    train_stop_progress: float = setting(
        "DR_TRAIN_STOP_PROGRESS",
        0.0,
        "Finish when evaluations in a row reach this mean progress, percent; 0 for no limit.",
        between=(0, 100),
    )
    train_stop_evaluations: int = setting(
        "DR_TRAIN_STOP_EVALUATIONS",
        3,
        "How many evaluations in a row must reach DR_TRAIN_STOP_PROGRESS.",
        low=1,
    )
    train_eval_world: OptionalWorldName = setting(
        "DR_TRAIN_EVAL_WORLD",
        "",
        "Second track on which checkpoints are evaluated during training; empty for none.",
    )
    train_best_model_world: Literal["training", "evaluation", "both"] = setting(
        "DR_TRAIN_BEST_MODEL_WORLD",
        "training",
        "Which evaluations decide which checkpoint is best: those on the training track, on "
        "DR_TRAIN_EVAL_WORLD, or on both together.",
    )
    curriculum_file: str = setting(
        "DR_CURRICULUM_FILE",
        "",
        "File with the stages of the training, such as curriculum.yaml; empty for a training "
        "without stages.",
    )
    train_best_model_metric: Literal["progress", "reward", "laptime"] = setting(
        "DR_TRAIN_BEST_MODEL_METRIC",
        "progress",
        "What decides which checkpoint is best: clean laps, then their median time, for progress "
        "and laptime; the mean reward of its evaluation episodes for reward.",
    )
    train_max_steps_per_iteration: int = setting(
        "DR_TRAIN_MAX_STEPS_PER_ITERATION",
        10_000,
        "Maximum number of steps for one update of the policy.",
        low=1,
    )
    train_frozen_graph: bool = setting(
        "DR_TRAIN_FROZEN_GRAPH",
        True,
        "Also write each checkpoint as the graph that the physical car loads.",
    )
    train_rtf: float | None = setting(
        "DR_TRAIN_RTF", None, "Speed of the simulated clock.", low=0, ignored=FULL_SPEED
    )

    @property
    def eval_laps(self) -> int:
        """Per checkpoint, at least one."""
        laps = self.train_eval_laps
        return max(1, self.train_min_eval_trials) if laps is None else laps
