"""What the exit codes of all commands mean; for docs/commands.md too."""

from collections.abc import Mapping

EXIT_CODES: Mapping[int, str] = {
    0: "done",
    1: "a question was answered with no; `dr-logs*`, `dr-find-*` and `dr-get-robomaker-stats`: not "
    "running, or no log yet; or an internal error, whose traceback is in `data/logs/`",
    2: "wrong command line",
    3: "a setting, parameter file or reward function is wrong; a training is already running; the "
    "model exists already or is missing",
    4: "the bucket cannot be reached, read or written; a model has lost all its checkpoints; "
    "`dr-tracks fetch` cannot download its file; the car, or DeepRacer on AWS, cannot be reached "
    "or refuses what is asked",
    5: "a worker died and could not be restarted",
    6: "the training failed and cannot continue (NaN); the last good checkpoint is kept",
    7: "not available in this version, or it needs a program that is not installed; a library is "
    "missing, too old or broken, and the message has the command that mends it",
    8: "another training took over the model while this one did not respond; that one continues",
    9: "another machine or process trains the model, and `--no-wait` was given; nothing was done",
    10: "the training is complete, but the upload or import at its end failed; the reason and the "
    "command to repeat it are printed. The same start with `--resume-or-start` does only that work",
    75: "interrupted, can be resumed: the cloud takes the machine away, or SIGTERM came to a "
    "training that was started with `--resume-or-start`, or the bucket or its access keys did not "
    "come within 15 minutes, or the budget of the day is used up. The same command continues it, "
    "here or elsewhere",
    130: "interrupted by Ctrl-C; with `--foreground` the training is stopped, and what was learned "
    "is in the bucket",
    143: "stopped by SIGTERM; what was learned is in the bucket, and `--resume` continues it "
    "(without `--foreground` only the command ends, and the training continues). A stopped "
    "evaluation has no results",
}
