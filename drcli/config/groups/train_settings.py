"""How a training goes."""

from typing import Literal

from drcli.clouds.registry import CLOUDS
from drcli.config.fields import Group, setting
from drcli.config.groups.race import FULL_SPEED
from drcli.config.value_types import (
    THIS_MACHINE,
    Address,
    Command,
    Gpus,
    HostName,
    ListenHost,
    MailAddresses,
    MessageEvents,
    Price,
    Retention,
    SmtpUrl,
    TopicArn,
    TrackingUrl,
    TrackioProject,
    TrackioUrl,
)


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
        "Who starts the workers: this machine, or Ray on a cluster (`dr docs ray`).",
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


# What a training does when reward function or learning fail.


class FailureSettings(Group, title="Failures during a training"):
    reward_on_error: Literal["stop", "count"] = setting(
        "DR_REWARD_ON_ERROR",
        "count",
        "When the reward function fails: stop ends the training, count goes on and learns nothing "
        "from that step.",
    )
    reward_fallback: float = setting(
        "DR_REWARD_FALLBACK",
        0.001,
        "What traces and metrics show as the reward of a step whose call of the reward function "
        "failed; only with count.",
        between=(-100_000, 100_000),
    )
    reward_max_error_share: float = setting(
        "DR_REWARD_MAX_ERROR_SHARE",
        0.05,
        "The training ends when more than this share of a worker's last 2,000 calls of the reward "
        "function failed; 1 by default if DR_REWARD_ON_ERROR=count is set.",
        between=(0, 1),
    )
    train_max_rollbacks: int = setting(
        "DR_TRAIN_MAX_ROLLBACKS",
        0,
        "How often a training goes back to its last good checkpoint, with a third of the learning "
        "rate, when the loss is NaN or the policy has collapsed; 0 never.",
        between=(0, 20),
    )


# Live figures of a training for other tools.


class FigureSettings(Group, title="Live figures for other tools", file="system.env"):
    tensorboard: bool = setting(
        "DR_TENSORBOARD",
        False,
        "Write TensorBoard event files to data/tensorboard; needs the extra tensorboard.",
    )
    telegraf_host: HostName = setting(
        "DR_TELEGRAF_HOST",
        "",
        "Host whose Telegraf takes InfluxDB lines over UDP, for Grafana; empty for none.",
    )
    telegraf_port: int = setting("DR_TELEGRAF_PORT", 8092, "Its UDP port.", between=(1, 65_535))
    prometheus_folder: str = setting(
        "DR_PROMETHEUS_FOLDER",
        "",
        "Folder for a .prom file that node_exporter's textfile collector reads; empty for none.",
    )
    prometheus_port: int = setting(
        "DR_PROMETHEUS_PORT",
        0,
        "Port on which the trainer serves its figures at /metrics; 0 for none.",
        between=(0, 65_535),
    )
    prometheus_host: ListenHost = setting(
        "DR_PROMETHEUS_HOST",
        THIS_MACHINE,
        "Address on which it listens; 0.0.0.0 lets other machines read the figures.",
    )
    mlflow_url: TrackingUrl = setting(
        "DR_MLFLOW_URL", "", "Address of an MLflow server that gets a run; empty for none."
    )
    mlflow_experiment: str = setting(
        "DR_MLFLOW_EXPERIMENT", "deepracer", "Name of the experiment there."
    )
    trackio_url: TrackioUrl = setting(
        "DR_TRACKIO_URL",
        "",
        "Address of a trackio server that gets a run; its token is TRACKIO_WRITE_TOKEN in the "
        "environment. Empty for none.",
    )
    trackio_project: TrackioProject = setting(
        "DR_TRACKIO_PROJECT", "deepracer", "Name of the project there."
    )


# Trainings that nobody watches.


class InterruptionSettings(Group, title="Interruptions"):
    continue_on_spot_interruption: bool = setting(
        "DR_CONTINUE_ON_SPOT_INTERRUPTION",
        True,
        "Whether the next machine continues a training whose machine was taken away.",
    )
    time_to_live_minutes: float = setting(
        "DR_TIME_TO_LIVE_MINUTES",
        0.0,
        "Complete the training so many minutes after its first start, pauses included; 0 never.",
        between=(0.0, 10_000_000.0),
    )
    interruption_watch: str = setting(
        "DR_INTERRUPTION_WATCH",
        "auto",
        "Whose notices to watch for: those of the cloud that this machine belongs to, or this one.",
        file="system.env",
        choices=("auto", *CLOUDS, "off"),
    )
    interruption_command: Command = setting(
        "DR_INTERRUPTION_COMMAND",
        "",
        "Program that ends with exit code 0 when this machine is about to be taken away.",
        file="system.env",
    )
    metadata_service_url: str = setting(
        "DR_METADATA_SERVICE_URL",
        "",
        "Another address of the cloud's metadata service.",
        file="system.env",
    )
    on_rebalance: Literal["continue", "stop"] = setting(
        "DR_ON_REBALANCE",
        "continue",
        "What a mere recommendation to move to another machine does.",
        file="system.env",
    )
    sigterm_grace_seconds: float = setting(
        "DR_SIGTERM_GRACE_SECONDS",
        30.0,
        "How long a training may take to end after SIGTERM, before it would be killed.",
        between=(5.0, 3600.0),
        file="system.env",
    )


class TimedWorkSettings(Group, title="Uploads during and after a training"):
    regular_upload: int = setting(
        "DR_REGULAR_UPLOAD",
        0,
        "Minutes between uploads of the last checkpoint, with the best one at the end; 0 never.",
        low=0,
    )
    regular_physical_model_upload: int = setting(
        "DR_REGULAR_PHYSICAL_MODEL_UPLOAD",
        0,
        "Minutes between archives for the car; 0 never.",
        low=0,
    )
    upload_best_model: bool = setting(
        "DR_UPLOAD_BEST_MODEL", False, "Upload the model whenever it has a new best checkpoint."
    )
    upload_model_on_completion: bool = setting(
        "DR_UPLOAD_MODEL_ON_COMPLETION",
        False,
        "Upload the best checkpoint when the training ends or is interrupted.",
    )
    import_model_on_completion: bool = setting(
        "DR_IMPORT_MODEL_ON_COMPLETION",
        True,
        "Import the best checkpoint into DeepRacer on AWS when the training is complete; needs "
        "DR_DROA_URL.",
    )
    upload_keep: Retention = setting(
        "DR_UPLOAD_KEEP",
        "",
        "Checkpoints and car archives to keep where they are uploaded to, such as "
        "last-3,best,every-50; empty for all.",
    )
    upload_max_mb: int = setting(
        "DR_UPLOAD_MAX_MB",
        0,
        "Largest size of the checkpoints there, and of the car archives, in MB; 0 for no limit.",
        low=0,
    )
    on_end: str = setting(
        "DR_ON_END", "", "Command for the shell that runs when a training has ended, however."
    )


class CostSettings(Group, title="Money"):
    spot_price: Price = setting(
        "DR_SPOT_PRICE",
        "",
        "What this machine costs in USD per hour; auto asks EC2; empty if it does not matter.",
        file="system.env",
    )
    max_cost: float = setting(
        "DR_MAX_COST",
        0.0,
        "End the training when all its machines together have cost so many USD; 0 for no limit.",
        low=0,
    )
    daily_budget_hours: float = setting(
        "DR_DAILY_BUDGET_HOURS",
        0.0,
        "Machine hours that all trainings of this folder together may take on one day; 0 for no "
        "limit.",
        between=(0.0, 1_000_000.0),
        file="system.env",
    )
    daily_budget_money: float = setting(
        "DR_DAILY_BUDGET_MONEY",
        0.0,
        "USD that all trainings of this folder together may cost on one day, at DR_SPOT_PRICE; 0 "
        "for no limit.",
        between=(0.0, 1_000_000.0),
        file="system.env",
    )


class WatchSettings(Group, title="Watches", file="system.env"):
    stall_minutes: int = setting(
        "DR_STALL_MINUTES",
        10,
        "Minutes without any progress after which workers are restarted, and the training ends if "
        "that does not help; 0 never.",
        low=0,
    )
    disk_min_mb: int = setting(
        "DR_DISK_MIN_MB",
        500,
        "Free megabytes on the disk of data/ below which the training stops in time to save "
        "everything; 0 never.",
        low=0,
    )


class MessageSettings(Group, title="Messages", file="system.env"):
    sns_topic_arn: TopicArn = setting(
        "DR_SNS_TOPIC_ARN", "", "Topic of Amazon SNS for messages; if empty, MY_SNS_TOPIC."
    )
    webhook_url: Address = setting(
        "DR_WEBHOOK_URL", "", "Address for messages in Slack, Discord, Mattermost or your program."
    )
    mail_to: MailAddresses = setting("DR_MAIL_TO", "", "Mail addresses for messages.")
    mail_from: MailAddresses = setting(
        "DR_MAIL_FROM", "", "Sender of these mails; if empty, the first of DR_MAIL_TO."
    )
    smtp_url: SmtpUrl = setting(
        "DR_SMTP_URL",
        "",
        "Mail server, as in smtps://user:password@mail.example.com:465.",
    )
    message_events: MessageEvents = setting(
        "DR_MESSAGE_EVENTS",
        "start,resume,interruption,end,failure,stall",
        "What to tell: start, resume, interruption, end, failure, stall, stop, fault, recovery, "
        "stage, best, upload; or all.",
    )
