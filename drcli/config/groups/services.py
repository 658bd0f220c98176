"""The bucket, its server and its objects."""

from pathlib import Path
from typing import Literal

from drcli.config.fields import Group, setting
from drcli.config.value_types import (
    HOME_REGION,
    THIS_MACHINE,
    BucketName,
    CarHost,
    CheckpointText,
    Endpoint,
    FolderName,
    ListenHost,
    LogGroup,
    LogStreamPrefix,
    ModelText,
    ObjectKey,
    Region,
    UploadBucket,
)


class BucketSettings(Group, title="Bucket", file="system.env"):
    cloud: Literal["local", "remote", "aws", "azure"] = setting(
        "DR_CLOUD", "local", "Who serves the bucket: this machine, an S3 address, or Amazon."
    )
    bucket: BucketName = setting("DR_LOCAL_S3_BUCKET", "bucket", "Name of the bucket.")
    profile: str = setting(
        "DR_LOCAL_S3_PROFILE",
        "",
        "AWS profile with the access keys; if empty, the AWS library searches for them.",
    )
    aws_app_region: Region = setting("DR_AWS_APP_REGION", HOME_REGION, "AWS region.")
    remote_minio_url: Endpoint = setting(
        "DR_REMOTE_MINIO_URL", "", "Address of the S3 server for DR_CLOUD=remote and azure."
    )
    local_s3_engine: Literal["rclone", "minio", "moto"] = setting(
        "DR_LOCAL_S3_ENGINE", "rclone", "Program that serves the bucket for DR_CLOUD=local."
    )
    local_s3_port: int = setting(
        "DR_LOCAL_S3_PORT", 0, "Port of that program; 0 for any free port.", between=(0, 65_535)
    )
    s3_data_dir: Path = setting(
        "DR_S3_DATA_DIR", Path("data/s3"), "Folder in which that program stores the objects."
    )
    local_s3_idle_minutes: int = setting(
        "DR_LOCAL_S3_IDLE_MINUTES",
        10,
        "Minutes without a request after which that program (rclone) exits; 0 for never.",
        low=0,
    )
    experiment_name: FolderName = setting(
        "DR_EXPERIMENT_NAME",
        "",
        "Experiment to use: a folder in experiments/ with its own run.env and custom_files.",
    )


class KeySettings(Group, title="Places in the bucket"):
    model_prefix: ObjectKey = setting(
        "DR_LOCAL_S3_MODEL_PREFIX", "rl-deepracer-sagemaker", "Folder of the model."
    )
    pretrained: bool = setting(
        "DR_LOCAL_S3_PRETRAINED", False, "Start from the weights of another model."
    )
    pretrained_prefix: ObjectKey = setting(
        "DR_LOCAL_S3_PRETRAINED_PREFIX", "rl-sagemaker-pretrained", "Folder of that model."
    )
    pretrained_checkpoint: CheckpointText = setting(
        "DR_LOCAL_S3_PRETRAINED_CHECKPOINT",
        "last",
        "Which of its checkpoints: last, best, first-lap, three-laps, best-lap or a number.",
        cosmetic=True,  # other trainers read any other word as last
    )
    model_description: ModelText = setting(
        "DR_MODEL_DESCRIPTION", "", "What the model is, in a few words; lists of models show it."
    )
    custom_files_prefix: ObjectKey = setting(
        "DR_LOCAL_S3_CUSTOM_FILES_PREFIX", "custom_files", "Folder of your own files."
    )
    reward_key: ObjectKey = setting(
        "DR_LOCAL_S3_REWARD_KEY",
        "$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/reward_function.py",
        "Your reward function.",
    )
    hyperparameters_key: ObjectKey = setting(
        "DR_LOCAL_S3_HYPERPARAMETERS_KEY",
        "$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/hyperparameters.json",
        "Your hyperparameters.",
    )
    model_metadata_key: ObjectKey = setting(
        "DR_LOCAL_S3_MODEL_METADATA_KEY",
        "$DR_LOCAL_S3_CUSTOM_FILES_PREFIX/model_metadata.json",
        "Your actions, sensors and network.",
    )
    metrics_prefix: ObjectKey = setting(
        "DR_LOCAL_S3_METRICS_PREFIX", "$DR_LOCAL_S3_MODEL_PREFIX/metrics", "Folder of the metrics."
    )
    training_params_file: ObjectKey = setting(
        "DR_LOCAL_S3_TRAINING_PARAMS_FILE",
        "training_params.yaml",
        "Description of the training, below the model's folder.",
        old_names=("DR_LOCAL_S3_PARAMS_FILE",),
    )
    eval_params_file: ObjectKey = setting(
        "DR_LOCAL_S3_EVAL_PARAMS_FILE",
        "evaluation_params.yaml",
        "Description of the evaluation, below the model's folder.",
    )
    upload_s3_profile: str = setting(
        "DR_UPLOAD_S3_PROFILE",
        "default",
        "AWS profile with the access keys of the upload bucket.",
        file="system.env",
    )
    upload_s3_endpoint_url: Endpoint = setting(
        "DR_UPLOAD_S3_ENDPOINT_URL",
        "",
        "Address of that bucket's S3 server; if empty, the profile decides, else Amazon.",
        file="system.env",
    )
    upload_s3_bucket: UploadBucket = setting(
        "DR_UPLOAD_S3_BUCKET",
        "not-defined",
        "Bucket that models are uploaded to; not-defined for none.",
        file="system.env",
    )
    upload_s3_prefix: ObjectKey = setting(
        "DR_UPLOAD_S3_PREFIX",
        "$DR_LOCAL_S3_MODEL_PREFIX-1",
        "Folder of the model in the upload bucket.",
    )


# Whether workers show what they do.


class LiveSettings(Group, title="Live view", file="system.env"):
    live_view: bool = setting(
        "DR_LIVE_VIEW",
        True,
        "Show cameras and cars of running trainings and evaluations to the console of this "
        "machine.",
    )


# Logs of the processes of a run.


class LogSettings(Group, title="Logs", file="system.env"):
    log_max_mb: int = setting(
        "DR_LOG_MAX_MB",
        512,
        "Maximum size of one worker's log in MB, older parts included.",
        low=16,
    )
    log_json: bool = setting(
        "DR_LOG_JSON",
        False,
        "Also write each log as JSON lines, one object for each record.",
    )
    cloud_watch_enable: bool = setting(
        "DR_CLOUD_WATCH_ENABLE",
        False,
        "Send the logs of trainings and evaluations to Amazon CloudWatch.",
    )
    cloud_watch_log_group: LogGroup = setting(
        "DR_CLOUD_WATCH_LOG_GROUP", "/deepracer-for-cloud", "Log group there."
    )
    cloud_watch_log_stream_prefix: LogStreamPrefix = setting(
        "DR_CLOUD_WATCH_LOG_STREAM_PREFIX", "", "Beginning of the names of the log streams there."
    )
    cloud_watch_profile: str = setting(
        "DR_CLOUD_WATCH_PROFILE",
        "",
        "AWS profile for CloudWatch; if empty, that of a bucket at Amazon, or what the AWS library "
        "finds.",
    )
    cloud_watch_sim_trace: bool = setting(
        "DR_CLOUD_WATCH_SIM_TRACE",
        False,
        "Send the line of each simulation step, too; CloudWatch is paid by size.",
    )


# How much of this machine's processor a run may take.


class ProcessorSettings(Group, title="Processor", file="system.env"):
    priority: Literal["normal", "low"] = setting(
        "DR_PRIORITY",
        "normal",
        "low: trainings and evaluations leave processor and disk to other programs that want them.",
    )
    threads: int = setting(
        "DR_THREADS",
        0,
        "Most processor cores that a training or an evaluation uses; 0 for all.",
        between=(0, 1024),
    )


# The physical car.


class PhysicalCarSettings(Group, title="Physical car", file="system.env"):
    """Its password is never a setting."""

    car_address: CarHost = setting(
        "DR_CAR_ADDRESS",
        "",
        "Address of the car's web page, host or host:port; `dr-car --car` overrides it.",
    )


# The console, a web page.


class WebSettings(Group, title="Console", file="system.env"):
    webviewer_port: int = setting(
        "DR_WEBVIEWER_PORT", 8100, "Port of the console.", between=(1, 65_535)
    )
    webviewer_host: ListenHost = setting(
        "DR_WEBVIEWER_HOST",
        THIS_MACHINE,
        "Address on which the console listens; with 0.0.0.0, other machines can open it with its "
        "token.",
    )
    webviewer_auth: Literal["token", "none"] = setting(
        "DR_WEBVIEWER_AUTH",
        "token",
        "What the console asks for; with none, every user of this machine may use it.",
    )
