"""Every command by name, with the function behind it.

All names of DeepRacer-for-Cloud are here, so that scripts written for it find each of them.
"""

from dataclasses import dataclass
from typing import Literal

Section = Literal[
    "Train",
    "Evaluate",
    "Monitor",
    "Models",
    "Settings and files",
    "Tracks and rewards",
    "Not available yet",
]


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        name: As in `dr NAME` and `dr-NAME`.
        section: Heading in `dr --help`.
        help: One line there.
        place: `module:object` below `drcli.cli.commands`: a function, or a Typer application.
            Where it is empty, module and function are called like the command.
        takes_any: Whether the command accepts any option: those of DeepRacer-for-Cloud for what
            is not available, or those of another program.
        hidden: Whether only our own scripts use it: no line in `dr --help`, no program.
    """

    name: str
    section: Section
    help: str
    place: str = ""
    takes_any: bool = False
    hidden: bool = False

    @property
    def target(self) -> str:
        """The place, also where it follows from the name."""
        name = self.name.replace("-", "_")
        return self.place or f"{name}:{name}"


def _unavailable(name: str, what: str) -> Command:
    place = f"not_built:{name.replace('-', '_')}"
    return Command(name, "Not available yet", what, place, takes_any=True)


COMMANDS: tuple[Command, ...] = (
    Command("start-training", "Train", "Train the model that run.env describes."),
    Command("stop-training", "Train", "Stop the training; what was learned is kept."),
    Command("increment-training", "Train", "Start a new model from this one's weights."),
    Command("stop-all", "Train", "Stop everything that was started in this folder."),
    Command("evaluate", "Evaluate", "Drive evaluation laps and report the result."),
    Command(
        "start-evaluation",
        "Evaluate",
        "Same as evaluate (name in DeepRacer-for-Cloud).",
        "evaluate:evaluate",
    ),
    Command("stop-evaluation", "Evaluate", "Stop a running evaluation."),
    Command("status", "Monitor", "Show the training: state, curves, checkpoints."),
    Command("summary", "Monitor", "Show settings, bucket and runs on one page."),
    Command("logs", "Monitor", "Show a worker's log."),
    Command(
        "logs-sagemaker", "Monitor", "Follow the trainer's log.", "reference_logs:logs_sagemaker"
    ),
    Command(
        "logs-robomaker",
        "Monitor",
        "Follow the log of a simulation worker.",
        "reference_logs:logs_robomaker",
    ),
    Command(
        "find-sagemaker",
        "Monitor",
        "Print the process number of the trainer.",
        "reference_logs:find_sagemaker",
    ),
    Command(
        "find-robomaker",
        "Monitor",
        "Print those of the simulation workers.",
        "reference_logs:find_robomaker",
    ),
    Command(
        "get-robomaker-stats",
        "Monitor",
        "Show how fast a simulation worker drives.",
        "reference_logs:get_robomaker_stats",
    ),
    Command("upload-model", "Models", "Copy a model to another bucket."),
    Command("increment-upload-model", "Models", "Raise the number in the next upload's name."),
    Command("download-model", "Models", "Copy a model from another bucket."),
    Command("list-models", "Models", "List the models in the bucket."),
    Command(
        "list-aws-models",
        "Models",
        "List the models in the upload bucket.",
        "list_models:list_aws_models",
    ),
    Command("set-upload-model", "Models", "Choose the name of the next upload."),
    Command("init", "Settings and files", "Create a working folder."),
    Command("config", "Settings and files", "Show, check and change settings.", "config:app"),
    Command("validate", "Settings and files", "Check everything that a training needs."),
    Command(
        "upload-custom-files",
        "Settings and files",
        "Copy custom_files/ to the bucket.",
        "custom_files:upload_custom_files",
    ),
    Command(
        "download-custom-files",
        "Settings and files",
        "Copy custom_files/ from the bucket.",
        "custom_files:download_custom_files",
    ),
    Command("update", "Settings and files", "Check whether the settings are right."),
    Command("update-env", "Settings and files", "Same as update.", "update:update"),
    Command("reload", "Settings and files", "Same as update.", "update:update"),
    Command("url", "Settings and files", "Show the addresses of bucket and model."),
    Command(
        "local-aws",
        "Settings and files",
        "Run the aws command on the bucket.",
        takes_any=True,
    ),
    Command(
        "completion", "Settings and files", "Install shell completion (Tab).", "completion:app"
    ),
    Command("shell-env", "Settings and files", "Print the settings for activate.sh.", hidden=True),
    Command("tracks", "Tracks and rewards", "List, show, add and fetch tracks.", "tracks:app"),
    Command(
        "reward", "Tracks and rewards", "Check, plot and compare reward functions.", "reward:app"
    ),
    _unavailable("upload-car-zip", "Archives for the physical car."),
    _unavailable("start-viewer", "Live pictures of the cars."),
    _unavailable("stop-viewer", "Live pictures of the cars."),
    _unavailable("update-viewer", "Live pictures of the cars."),
    _unavailable("view-stream", "Live pictures of the cars."),
    _unavailable("start-metrics", "Curves in Grafana."),
    _unavailable("stop-metrics", "Curves in Grafana."),
    _unavailable("start-loganalysis", "Notebooks for log analysis."),
    _unavailable("stop-loganalysis", "Notebooks for log analysis."),
    _unavailable("logs-loganalysis", "Notebooks for log analysis."),
    _unavailable("url-loganalysis", "Notebooks for log analysis."),
    _unavailable("start-tournament", "Tournaments; dr evaluate races two models."),
    _unavailable("droa-list-models", "DeepRacer on AWS."),
    _unavailable("droa-get-model", "DeepRacer on AWS."),
    _unavailable("droa-download-logs", "DeepRacer on AWS."),
    _unavailable("droa-delete-model", "DeepRacer on AWS."),
    _unavailable("droa-import-model", "DeepRacer on AWS."),
)


def program_names() -> dict[str, str]:
    """The name of each installed program, and the command that it runs."""
    programs = {
        name if (name := command.name).startswith("droa-") else f"dr-{name}": command.name
        for command in COMMANDS
        if not command.hidden
    }
    return {"dr": "", **programs}
