"""Every command by name, with all of DeepRacer-for-Cloud's."""

from dataclasses import dataclass, replace
from typing import Literal

Group = Literal["Start here", "Train", "Look", "Models", "Race and car"]


@dataclass(frozen=True)
class Command:
    """One command: `dr NAME` or `dr-NAME`.

    Attributes:
        module: Below `drcli.cli.commands`; empty: named like the command, as is `function`.
        everyday: Whether `dr --help` shows it; `dr --help --all` shows all.
        same_as: What to call instead: this one is kept for scripts and habits.
        takes_any: Whether it accepts any option: those of another program.
        default: Subcommand if the first word names none.
        hidden: Only for our own scripts.
    """

    name: str
    help: str = ""
    module: str = ""
    function: str = ""
    everyday: bool = False
    same_as: str = ""
    takes_any: bool = False
    default: str = ""
    hidden: bool = False
    group: Group = "Start here"

    @property
    def place(self) -> tuple[str, str]:
        name = self.name.replace("-", "_")
        return self.module or name, self.function or name


def _everyday(
    name: str, text: str, module: str = "", function: str = "", default: str = ""
) -> Command:
    return Command(name, text, module, function, everyday=True, default=default)


def _former(name: str, same_as: str, module: str, function: str = "") -> Command:
    text = f"Same as {same_as}."
    return Command(name, text, module, function, same_as=same_as)


def _group(group: Group, *commands: Command) -> tuple[Command, ...]:
    return tuple(replace(command, group=group) for command in commands)


COMMANDS: tuple[Command, ...] = (
    *_group(
        "Start here",
        _everyday("init", "Create a working folder."),
        _everyday("config", "Show, check and change settings.", function="app"),
        _everyday("doctor", "Examine installation, machine and bucket."),
        _everyday("help", "Explain a command. All: dr --help --all.", function="explain_command"),
        Command("validate", "Check everything that a training needs."),
        _everyday("docs", "Show a page of the documentation.", "help"),
        Command("explain", "Explain a hyperparameter, setting, word, exit code or error."),
        Command("update", "Check whether the settings are right.", "validate"),
        Command("bench", "Measure how fast this machine trains."),
        Command("completion", "Install shell completion (Tab).", function="app"),
        Command("version", "Show the versions of all that a training depends on."),
        Command("support-bundle", "Pack what helps others to help you, without secrets."),
        Command("url", "Show the addresses of bucket and model."),
        Command("local-aws", "Run the aws command on the bucket.", takes_any=True),
        Command("shell-env", "Print the settings for activate.sh.", hidden=True),
        _former("update-env", "update", "validate", "update"),
        _former("reload", "update", "validate", "update"),
    ),
    *_group(
        "Train",
        _everyday("tracks", "List, show, add and fetch tracks.", function="app"),
        _everyday("reward", "Check, plot and compare reward functions.", function="app"),
        _everyday("start-training", "Train the model that run.env describes."),
        _everyday("stop-training", "Stop the training; keep what it learned.", "stop"),
        _everyday("increment-training", "Start a new model from this one's weights.", "increments"),
        Command("action-space", "Draw, generate and write a model's actions.", function="app"),
        Command(
            "sweep",
            "Train variants side by side, and find the best.",
            function="app",
            default="start",
        ),
        Command("spot", "Train on spot machines of Amazon.", function="app"),
        Command("start-worker", "Drive for a training on another machine."),
        Command("stop-all", "Stop everything that was started in this folder.", "stop"),
        Command("send-message", "Send a message as trainings do."),
    ),
    *_group(
        "Look",
        _everyday("console", "Open the console, a page in the browser.", "viewer", "app", "open"),
        _everyday("status", "Show state, curves and checkpoints."),
        Command("attach", "Show the live display of a running training again.", "status"),
        _everyday("logs", "Show logs, or what the reward prints."),
        _everyday("analyze", "Analyse a training: verdict, laps, advice."),
        _everyday("evaluate", "Drive evaluation laps; report the result."),
        _everyday("video", "Film a lap, with what the car sees."),
        Command("stop-evaluation", "Stop a running evaluation.", "stop"),
        Command("saliency", "Show which pixels of the camera move the car."),
        Command("summary", "Show settings, bucket and runs on one page.", "status"),
        Command("journal", "Show what happened to the model, on all machines."),
        Command(
            "history",
            "List, compare and export all trainings, also of deleted models.",
            "training_history",
            "app",
            default="list",
        ),
        Command("metrics", "Start or stop TensorBoard, and show where figures go.", function="app"),
        Command("start-loganalysis", "Write the report of dr-analyze, and open it.", "loganalysis"),
        Command("url-loganalysis", "Print the address of that report.", "loganalysis"),
        Command("stop-loganalysis", "Nothing to stop: the report is a file.", "loganalysis"),
        Command("logs-loganalysis", "Show what was wrong with the files.", "loganalysis"),
        Command("logs-sagemaker", "Follow the trainer's log.", "reference_logs"),
        Command("logs-robomaker", "Follow a simulation worker's log.", "reference_logs"),
        Command("find-sagemaker", "Print the trainer's process number.", "reference_logs"),
        Command("find-robomaker", "Print the workers' process numbers.", "reference_logs"),
        Command("get-robomaker-stats", "Show a simulation worker's speed.", "reference_logs"),
        _former("start-evaluation", "evaluate", "evaluate", "evaluate"),
        _former("start-viewer", "console start", "viewer"),
        _former("stop-viewer", "console stop", "viewer"),
        _former("update-viewer", "console restart", "viewer"),
        _former("view-stream", "console stream", "viewer"),
        _former("start-metrics", "metrics start", "metrics"),
        _former("stop-metrics", "metrics stop", "metrics"),
    ),
    *_group(
        "Models",
        _everyday("list-models", "List the models in the bucket."),
        Command("download-model", "Copy a model from another bucket.", "copy_model"),
        _everyday("upload-model", "Copy a model to another bucket.", "copy_model"),
        _everyday("export", "Write a model for the car, ONNX and more.", function="app"),
        Command(
            "import", "Make a model of another system a model here.", "import_model", "import_model"
        ),
        Command("list-checkpoints", "List the checkpoints of a model, with their laps."),
        Command("note", "Write notes about a model.", function="app"),
        Command("delete-model", "Delete models and all their traces."),
        Command("tidy", "Delete what is left over in the bucket."),
        Command("set-upload-model", "Choose the name of the next upload.", "increments"),
        Command(
            "increment-upload-model", "Raise the number in the next upload's name.", "increments"
        ),
        Command("upload-custom-files", "Copy custom_files/ to the bucket.", "custom_files"),
        Command("download-custom-files", "Copy custom_files/ from the bucket.", "custom_files"),
        _former("list-aws-models", "list-models --upload", "list_models"),
    ),
    *_group(
        "Race and car",
        _everyday("race", "Race models on a leaderboard, or in pairs.", function="app"),
        _everyday("car", "Send models to the physical car; drive it.", function="app"),
        Command("start-tournament", "Drive the pairs of a head-to-head race.", "tournament"),
        Command("upload-car-zip", "Upload an archive for the physical car.", "export"),
        Command(
            "droa", "Import models into DeepRacer on AWS, and manage them there.", function="app"
        ),
        _former("droa-login", "droa login", "droa"),
        _former("droa-logout", "droa logout", "droa"),
        _former("droa-list-models", "droa list", "droa"),
        _former("droa-get-model", "droa show", "droa"),
        _former("droa-import-model", "droa import", "droa"),
        _former("droa-download-logs", "droa download", "droa"),
        _former("droa-delete-model", "droa delete", "droa"),
    ),
)


OF_REFERENCE = frozenset(
    f"dr-{name}"
    for name in (
        *("reload", "update", "update-env", "summary", "view-stream", "list-aws-models"),
        *("start-training", "stop-training", "increment-training", "stop-all"),
        *("start-evaluation", "stop-evaluation", "start-tournament"),
        *("start-loganalysis", "stop-loganalysis", "logs-loganalysis", "url-loganalysis"),
        *("logs-sagemaker", "logs-robomaker", "find-sagemaker", "find-robomaker"),
        *("get-robomaker-stats", "start-viewer", "stop-viewer", "update-viewer"),
        *("start-metrics", "stop-metrics", "upload-custom-files", "download-custom-files"),
        *("upload-model", "download-model", "upload-car-zip"),
        *("set-upload-model", "increment-upload-model"),
    )
)
"""Programs that scripts for DeepRacer-for-Cloud call, also with options that we do not have."""


def program_names() -> dict[str, str]:
    programs = {
        name if (name := command.name).startswith("droa-") else f"dr-{name}": command.name
        for command in COMMANDS
        if not command.hidden
    }
    return {"dr": "", **programs}
