"""Every command by name, with the function behind it; nothing is loaded before it is called.

The names of the reference are all here: scripts written for it find each of them.
"""

from dataclasses import dataclass
from typing import Literal

Section = Literal[
    "Train",
    "Evaluate",
    "Look",
    "Models",
    "Settings and files",
    "Tracks and rewards",
    "Names of the reference",
]


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        name: As in `dr NAME` and `dr-NAME`.
        target: `module:object` below `drcli.cli.commands`: a function, or a Typer group.
        section: Heading in `dr --help`.
        help: One line there.
        takes_any: Whether options are taken as they come: those of the reference for what is not
            built, or those of another program.
        hidden: Whether it serves our own scripts only: no line in `dr --help`, no program.
    """

    name: str
    target: str
    section: Section
    help: str
    takes_any: bool = False
    hidden: bool = False


COMMANDS: tuple[Command, ...] = (
    Command(
        "start-training", "start_training:start_training", "Train", "Train the model of run.env."
    ),
    Command("stop-training", "stop_training:stop_training", "Train", "Stop; nothing is lost."),
    Command(
        "increment-training",
        "increment_training:increment_training",
        "Train",
        "Go on from this model's weights under a new name.",
    ),
    Command("stop-all", "stop_all:stop_all", "Train", "Stop everything started in this folder."),
    Command("evaluate", "evaluate:evaluate", "Evaluate", "Drive evaluation laps and report them."),
    Command(
        "start-evaluation", "evaluate:evaluate", "Evaluate", "The reference's name of evaluate."
    ),
    Command("stop-evaluation", "stop_evaluation:stop_evaluation", "Evaluate", "End an evaluation."),
    Command("status", "status:status", "Look", "How the training goes: curves, checkpoints."),
    Command("summary", "summary:summary", "Look", "Settings, bucket and runs on one page."),
    Command("logs", "logs:logs", "Look", "What a worker has to say."),
    Command("logs-sagemaker", "reference_logs:logs_sagemaker", "Look", "Follow the trainer's log."),
    Command(
        "logs-robomaker",
        "reference_logs:logs_robomaker",
        "Look",
        "Follow a simulation worker's log.",
    ),
    Command("find-sagemaker", "reference_logs:find_sagemaker", "Look", "Process of the trainer."),
    Command(
        "find-robomaker",
        "reference_logs:find_robomaker",
        "Look",
        "Process of a simulation worker.",
    ),
    Command(
        "get-robomaker-stats",
        "reference_logs:get_robomaker_stats",
        "Look",
        "How fast a simulation worker drives.",
    ),
    Command(
        "upload-model", "upload_model:upload_model", "Models", "Copy a model to another bucket."
    ),
    Command(
        "increment-upload-model",
        "increment_upload_model:increment_upload_model",
        "Models",
        "Give the next upload a new name.",
    ),
    Command(
        "download-model", "download_model:download_model", "Models", "Fetch a model from a bucket."
    ),
    Command("list-models", "list_models:list_models", "Models", "Models in a bucket."),
    Command(
        "list-aws-models",
        "list_models:list_aws_models",
        "Models",
        "Models in the bucket of uploads.",
    ),
    Command(
        "set-upload-model",
        "set_upload_model:set_upload_model",
        "Models",
        "Choose the name of the next upload.",
    ),
    Command(
        "upload-car-zip",
        "not_built:upload_car_zip",
        "Models",
        "Archive for the car.",
        takes_any=True,
    ),
    Command("init", "init:init", "Settings and files", "Write a working folder."),
    Command("config", "config:app", "Settings and files", "Show, check and change settings."),
    Command("validate", "validate:validate", "Settings and files", "Check everything, by rule."),
    Command(
        "upload-custom-files",
        "custom_files:upload_custom_files",
        "Settings and files",
        "Copy custom_files/ to the bucket.",
    ),
    Command(
        "download-custom-files",
        "custom_files:download_custom_files",
        "Settings and files",
        "Copy them back.",
    ),
    Command("update", "update:update", "Settings and files", "Read the settings again."),
    Command("update-env", "update:update", "Settings and files", "The same as update."),
    Command("reload", "update:update", "Settings and files", "The same as update."),
    Command("url", "url:url", "Settings and files", "Addresses of bucket and objects."),
    Command(
        "local-aws",
        "local_aws:local_aws",
        "Settings and files",
        "The aws command on our bucket.",
        takes_any=True,
    ),
    Command(
        "completion", "completion:app", "Settings and files", "Let the Tab key finish commands."
    ),
    Command(
        "shell-env",
        "shell_env:shell_env",
        "Settings and files",
        "Settings as variables of a shell.",
        hidden=True,
    ),
    Command("tracks", "tracks:app", "Tracks and rewards", "List, show, add and fetch tracks."),
    Command("reward", "reward:app", "Tracks and rewards", "Check, plot and compare rewards."),
    *(
        Command(
            name,
            f"not_built:{name.replace('-', '_')}",
            "Names of the reference",
            help,
            takes_any=True,
        )
        for name, help in (
            ("start-viewer", "Pictures of the cars."),
            ("stop-viewer", "Pictures of the cars."),
            ("update-viewer", "Pictures of the cars."),
            ("view-stream", "Pictures of the cars."),
            ("start-metrics", "Curves in Grafana."),
            ("stop-metrics", "Curves in Grafana."),
            ("start-loganalysis", "Notebooks."),
            ("stop-loganalysis", "Notebooks."),
            ("logs-loganalysis", "Notebooks."),
            ("url-loganalysis", "Notebooks."),
            ("start-tournament", "Races of several models."),
            ("droa-list-models", "DeepRacer on AWS."),
            ("droa-get-model", "DeepRacer on AWS."),
            ("droa-download-logs", "DeepRacer on AWS."),
            ("droa-delete-model", "DeepRacer on AWS."),
            ("droa-import-model", "DeepRacer on AWS."),
        )
    ),
)


def program_names() -> dict[str, str]:
    """Name of each installed program with the command it runs."""
    programs = {
        name if (name := command.name).startswith("droa-") else f"dr-{name}": command.name
        for command in COMMANDS
        if not command.hidden
    }
    return {"dr": "", **programs}
