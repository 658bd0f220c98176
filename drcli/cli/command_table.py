"""Every command by name, with all of DeepRacer-for-Cloud's."""

from dataclasses import dataclass, replace
from typing import Literal

Section = Literal[
    "Train",
    "Evaluate",
    "Monitor",
    "Spot instances",
    "Models",
    "Settings and files",
    "Tracks and rewards",
]


@dataclass(frozen=True)
class Command:
    """One command: `dr NAME` or `dr-NAME`.

    Attributes:
        module: Below `drcli.cli.commands`; empty: named like the command, as is `function`.
        takes_any: Whether it accepts any option: those of another program.
        default: Subcommand if the first word names none.
        hidden: Only for our own scripts.
    """

    name: str
    help: str
    module: str = ""
    function: str = ""
    takes_any: bool = False
    default: str = ""
    hidden: bool = False
    section: Section = "Train"

    @property
    def place(self) -> tuple[str, str]:
        name = self.name.replace("-", "_")
        return self.module or name, self.function or name


def _section(section: Section, *commands: Command) -> tuple[Command, ...]:
    return tuple(replace(command, section=section) for command in commands)


COMMANDS: tuple[Command, ...] = (
    *_section(
        "Train",
        Command("start-training", "Train the model that run.env describes."),
        Command("stop-training", "Stop the training; what was learned is kept.", "stop"),
        Command("start-worker", "Drive for a training on another machine."),
        Command("increment-training", "Start a new model from this one's weights.", "increments"),
        Command("stop-all", "Stop everything that was started in this folder.", "stop"),
        Command(
            "sweep",
            "Train variants side by side, and find the best.",
            function="app",
            default="start",
        ),
        Command("spot", "Train on spot machines of Amazon.", function="app"),
    ),
    *_section(
        "Evaluate",
        Command("evaluate", "Drive evaluation laps and report the result."),
        Command(
            "start-evaluation",
            "Same as evaluate (name in DeepRacer-for-Cloud).",
            "evaluate",
            "evaluate",
        ),
        Command("stop-evaluation", "Stop a running evaluation.", "stop"),
        Command("race", "Race models on a leaderboard, or in pairs.", function="app"),
        Command("start-tournament", "Drive the pairs of a head-to-head race.", "tournament"),
        Command("video", "Make a video of a lap, with what the car sees."),
        Command("saliency", "Show which pixels of the camera move the car."),
    ),
    *_section(
        "Monitor",
        Command("status", "Show the training: state, curves, checkpoints."),
        Command("summary", "Show settings, bucket and runs on one page.", "status"),
        Command("journal", "Show what happened to the model, on all machines."),
        Command(
            "history",
            "List, compare and export all trainings, also of deleted models.",
            "training_history",
            "app",
            default="list",
        ),
        Command("logs", "Show a worker's log, or what the reward function prints."),
        Command("analyze", "Analyse a training: verdict, curves, laps, advice."),
        Command("start-loganalysis", "Write the report of dr-analyze, and open it.", "loganalysis"),
        Command("url-loganalysis", "Print the address of that report.", "loganalysis"),
        Command("stop-loganalysis", "Nothing to stop: the report is a file.", "loganalysis"),
        Command("logs-loganalysis", "Show what was wrong with the files.", "loganalysis"),
        Command("logs-sagemaker", "Follow the trainer's log.", "reference_logs"),
        Command("logs-robomaker", "Follow a simulation worker's log.", "reference_logs"),
        Command("find-sagemaker", "Print the trainer's process number.", "reference_logs"),
        Command("find-robomaker", "Print the workers' process numbers.", "reference_logs"),
        Command("get-robomaker-stats", "Show a simulation worker's speed.", "reference_logs"),
        Command(
            "console",
            "Open the console: trainings, models and races on a web page.",
            "viewer",
            "console_page",
        ),
        Command("start-viewer", "Start the console and print its address.", "viewer"),
        Command("stop-viewer", "Stop the console.", "viewer"),
        Command("update-viewer", "Start the console again, with the settings of now.", "viewer"),
        Command("view-stream", "Print the addresses of live pictures, as MJPEG.", "viewer"),
        Command("send-message", "Send a message as trainings do."),
        Command("start-metrics", "Show curves in TensorBoard, and where others go.", "metrics"),
        Command("stop-metrics", "Stop TensorBoard.", "metrics"),
    ),
    *_section(
        "Spot instances",
    ),
    *_section(
        "Models",
        Command("upload-model", "Copy a model to another bucket.", "copy_model"),
        Command(
            "increment-upload-model", "Raise the number in the next upload's name.", "increments"
        ),
        Command("download-model", "Copy a model from another bucket.", "copy_model"),
        Command("export", "Write a model in the form of other systems.", function="app"),
        Command(
            "import",
            "Make a model of another system a model here.",
            "import_model",
            "import_model",
        ),
        Command("upload-car-zip", "Upload an archive for the physical car.", "export"),
        Command("list-models", "List the models in the bucket."),
        Command("list-checkpoints", "List the checkpoints of a model, with their laps."),
        Command("note", "Write notes about a model.", function="app"),
        Command("delete-model", "Delete models and all their traces."),
        Command("tidy", "Delete what is left over in the bucket."),
        Command("list-aws-models", "List the models in the upload bucket.", "list_models"),
        Command("set-upload-model", "Choose the name of the next upload.", "increments"),
        Command("car", "Send models to the physical car, and drive it.", function="app"),
        Command("droa-login", "Sign in to DeepRacer on AWS.", "droa"),
        Command("droa-logout", "Forget the keys of DeepRacer on AWS.", "droa"),
        Command("droa-list-models", "List your models at DeepRacer on AWS.", "droa"),
        Command("droa-get-model", "Show a model at DeepRacer on AWS.", "droa"),
        Command("droa-import-model", "Import a model into DeepRacer on AWS.", "droa"),
        Command("droa-download-logs", "Download from DeepRacer on AWS.", "droa"),
        Command("droa-delete-model", "Delete a model at DeepRacer on AWS.", "droa"),
    ),
    *_section(
        "Settings and files",
        Command("init", "Create a working folder."),
        Command("config", "Show, check and change settings.", function="app"),
        Command("validate", "Check everything that a training needs."),
        Command("doctor", "Examine the installation, this machine and the bucket."),
        Command("bench", "Measure how fast this machine trains."),
        Command("support-bundle", "Pack what helps others to help you, without secrets."),
        Command("upload-custom-files", "Copy custom_files/ to the bucket.", "custom_files"),
        Command("download-custom-files", "Copy custom_files/ from the bucket.", "custom_files"),
        Command("update", "Check whether the settings are right.", "validate"),
        Command("update-env", "Same as update.", "validate", "update"),
        Command("reload", "Same as update.", "validate", "update"),
        Command("explain", "Explain a hyperparameter, setting, word, exit code or error."),
        Command("url", "Show the addresses of bucket and model."),
        Command("local-aws", "Run the aws command on the bucket.", takes_any=True),
        Command("completion", "Install shell completion (Tab).", function="app"),
        Command("shell-env", "Print the settings for activate.sh.", hidden=True),
    ),
    *_section(
        "Tracks and rewards",
        Command("action-space", "Draw, generate and write a model's actions.", function="app"),
        Command("tracks", "List, show, add and fetch tracks.", function="app"),
        Command("reward", "Check, plot and compare reward functions.", function="app"),
    ),
)


def program_names() -> dict[str, str]:
    programs = {
        name if (name := command.name).startswith("droa-") else f"dr-{name}": command.name
        for command in COMMANDS
        if not command.hidden
    }
    return {"dr": "", **programs}
