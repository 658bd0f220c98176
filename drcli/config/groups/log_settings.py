"""Logs of the processes of a run."""

from drcli.config.fields import Group, setting
from drcli.config.value_types import LogGroup, LogStreamPrefix


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
