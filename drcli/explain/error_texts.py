"""Error texts of DeepRacer-for-Cloud, the console and the car, with answers.

docs/troubleshooting.md lists them. drcli says most of them in other words: docs/errors.md.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ErrorText:
    """An error text of another program; `...` stands for what varies."""

    text: str
    reason: str
    here: str


ERROR_TEXTS: tuple[ErrorText, ...] = (
    ErrorText(
        "Found a lock file ..., waiting",
        "a program was killed while it wrote a checkpoint, and left its `.lock` file behind; "
        "everybody waits for it for ever",
        "drcli writes no lock files. A checkpoint counts only when its pointer is written, and a "
        "dead owner's lease expires after a minute. In a model of the reference, delete the "
        "`.lock` "
        "object below `model/` before DeepRacer-for-Cloud reads it again; drcli ignores it",
    ),
    ErrorText(
        "Received termination signal from trainer. Goodbye.",
        "the worker found `.finished` in the bucket: the trainer has ended, often after NaN, or "
        "the file is left from an earlier run",
        "our worker prints the same line when a training ends, so log tools find it. "
        "`dr-status` and "
        "`dr-journal` say why it ended; nothing has to be deleted before the next start",
    ),
    ErrorText(
        "NaN detected in loss function, aborting training.",
        "the learning rate was too high, or a reward much too large; the weights are useless",
        "the training ends with code 6 and keeps the last good checkpoint. Lower `lr` to a "
        "third, or "
        "set `max_grad_norm`, then use `dr-start-training --resume`: [learning.md](learning.md)",
    ),
    ErrorText(
        "Unable to finish 1 lap",
        "the race's evaluation saw no complete lap: the model does not drive reliably, or only on "
        "the track it was trained on",
        "evaluate more laps (`dr-evaluate --laps 40`) and on the other track "
        "(`DR_WORLD_NAME=... dr-evaluate`); choose `best` by more laps "
        "(`DR_TRAIN_EVAL_LAPS=40`), or train with disturbances: "
        "[simulation.md](simulation.md)",
    ),
    ErrorText(
        "Reward function error: ...",
        "the reward function raised an exception or returned NaN, infinity, or a value beyond "
        "100000",
        "the message names the line in your file. `dr-reward check` finds such errors before the "
        "training: [reward-functions.md](reward-functions.md)",
    ),
    ErrorText(
        "Failed to import user's reward_function: ...",
        "the file has a syntax error, or imports a package that is not installed",
        "`dr-validate` shows the line before the start",
    ),
    ErrorText(
        "Selected path s3://... exists. Delete it, or use -w option. Exiting.",
        "there is a model with this name, or with a name that begins alike",
        "use `--resume` to continue it, or choose another name (`-w` deletes it). Names that only "
        "begin alike do not matter",
    ),
    ErrorText(
        "Training aborted. Configuration files were not found.",
        "reward function, metadata or hyperparameters are not in the bucket",
        "drcli reads `custom_files/` in your folder first, then the bucket, then its examples; "
        "`dr-validate` says which files it uses",
    ),
    ErrorText(
        "ERROR: Processes running in stack deepracer-.... Stop training with dr-stop-training.",
        "a training with this run id is running",
        "`dr-status` shows it, `dr-stop-training` stops it. Use another `DR_RUN_ID` to run two",
    ),
    ErrorText(
        "ERROR: AWS credentials not found in profile ...",
        "the profile has no keys in `~/.aws/credentials`",
        "not needed with `DR_CLOUD=local`. Otherwise set `DR_LOCAL_S3_PROFILE`; `dr-doctor` tests "
        "the keys",
    ),
    ErrorText(
        "File system.env does not exist.",
        "the script was not started in the working folder",
        "change to the folder with `run.env`, or create one with `dr-init`",
    ),
    ErrorText(
        "Experiment directory ... does not exist.",
        "`DR_EXPERIMENT_NAME` names a folder that is not there",
        "`dr-init --experiment NAME` creates it",
    ),
    ErrorText(
        "No X Server running on display .... Exiting",
        "`DR_HOST_X=True`, but no X server answers",
        "drcli needs no display; the setting may stay and does nothing",
    ),
    ErrorText(
        "No XAUTHORITY defined",
        "as above: the X server's key is missing",
        "drcli needs no display",
    ),
    ErrorText(
        "ERROR: No Swarm Nodes labelled ...",
        "Docker Swarm has no node for the simulation or the trainer",
        "drcli needs no Docker",
    ),
    ErrorText(
        "Swarm exists. Exiting.",
        "`init.sh` wants to create a Docker Swarm, and there is one",
        "drcli needs no Docker; use `dr-init`",
    ),
    ErrorText(
        "Sagemaker is not running.",
        "the trainer's container is missing: it ended, or never started, for example without the "
        "NVIDIA runtime, while the simulator lives on",
        "`dr-status` names the part that is missing and why it ended; when a worker cannot go on, "
        "the whole training ends with code 5 and its logs are kept (`dr-logs trainer`)",
    ),
    ErrorText(
        "Robomaker #... is not running.",
        "the simulator's container is missing",
        "`dr-status`, then `dr-logs sim`",
    ),
    ErrorText(
        "No running robomakers. Exiting.",
        "the viewer found no simulator",
        "`dr-start-viewer` starts without a training, and shows its workers as soon as they drive",
    ),
    ErrorText(
        "Target equals source. Exiting.",
        "an upload would write a model over itself",
        "choose another `DR_UPLOAD_S3_PREFIX` or bucket: [models.md](models.md)",
    ),
    ErrorText(
        "No upload bucket defined. Exiting.",
        "`DR_UPLOAD_S3_BUCKET` is empty",
        "set it in `system.env`, or use `-L` for the local bucket",
    ),
    ErrorText(
        "No upload prefix defined. Exiting.",
        "`DR_UPLOAD_S3_PREFIX` is empty",
        "`dr-set-upload-model NAME` sets it",
    ),
    ErrorText(
        "Meta-data files are not found. Exiting.",
        "the model to upload or download lacks its reward function, metadata, hyperparameters or "
        "metrics",
        "`dr-list-models` shows what is there. A model must be complete to be copied",
    ),
    ErrorText(
        "No model files found. Files possibly deleted. Try again.",
        "the chosen checkpoint was deleted while it was copied",
        "drcli chooses again by itself; with `-c N` choose a checkpoint that `dr-list-models` "
        "shows",
    ),
    ErrorText(
        "No source URL to download model from.",
        "`-s` is missing",
        "`dr-download-model -s s3://BUCKET/PREFIX -t NAME`",
    ),
    ErrorText(
        "No target prefix defined. Exiting.",
        "`-t` is missing",
        "`dr-download-model -s s3://BUCKET/PREFIX -t NAME`",
    ),
    ErrorText(
        "Invalid option",
        "the script does not know this option",
        "every command explains its options with `--help`",
    ),
    ErrorText(
        "ERROR: FAULT_CODE: ...",
        "a fatal error of the reference's simulator or trainer; the line before it, with "
        "`simapp_exception`, has the reason",
        "drcli prints one sentence and a remedy instead; `dr-status` repeats it",
    ),
    ErrorText(
        "Exited main loop. Done.",
        "the simulator has reached `term_cond_max_episodes`; in the reference the trainer may wait "
        "for it for ever",
        "trainer and workers end together here",
    ),
    ErrorText(
        "EC2 Spot Instance Interruption Warning",
        "Amazon takes the spot machine away in two minutes",
        "the training saves and ends with code 75; `dr-start-training --resume-or-start` continues "
        "it: [spot.md](spot.md)",
    ),
    ErrorText(
        "Invalid input head",
        "the car's TensorFlow Lite engine does not know the name of the model's input, and never "
        "drives",
        "`dr-export car --check FILE` finds this before you send the archive (rule C-10)",
    ),
    ErrorText(
        "Invalid servo request",
        "the model asks the car to steer further than its range: the ranges of "
        "`model_metadata.json` "
        "go further to the right than to the left",
        "`dr-export car` refuses such a model: [car.md](car.md)",
    ),
    ErrorText(
        "Model uploaded successfully to your vehicle",
        "the car has the archive. It does not say that it can use the model",
        "`dr-car upload` waits until the car lists the model, and says why it cannot be used",
    ),
    ErrorText(
        "Cannot cut empty array",
        "an analysis notebook found no `0-iteration.csv`, or the folder of a worker is missing",
        "copy the whole folder `training-simtrace/`, with all workers",
    ),
    ErrorText(
        "... was trained with ... actions, but action_space has ... here.",
        "this is drcli's own message (rule V-35). A clone, or a training that is resumed, needs "
        "the "
        "same number of actions, the same type of action space and the same sensors",
        "the values of the actions may change. For another number of actions, train a new model",
    ),
)
