"""The glossary, also of docs/glossary.md."""

from collections.abc import Mapping
from dataclasses import dataclass

GLOSSARY: Mapping[str, str] = {
    "action": "What the car is asked to do in one step: a steering angle and a speed.",
    "action space": "All actions that a model can choose from: a list (discrete), or a range of "
    "steering angles and a range of speeds (continuous). It is in `model_metadata.json`.",
    "advantage": "How much better an action turned out than the critic had expected. PPO makes "
    "actions with a positive advantage more likely.",
    "agent": "The part that decides: the policy with its car.",
    "argmax": "Taking the most likely action. Evaluations and the physical car do this; a training "
    "draws actions by their probability instead.",
    "batch": "The same as a minibatch: the steps from which the weights are changed once. "
    "`batch_size` says how many.",
    "best average of 3 laps": "The best mean time of three laps in a row (`DR_EVAL_AVERAGE_LAPS`). "
    "Leaderboards of the AWS League ranked by it.",
    "best checkpoint": "The checkpoint with the best evaluation so far, by "
    "`DR_TRAIN_BEST_MODEL_METRIC`.",
    "best-lap": "The checkpoint that drove the fastest clean evaluation lap. A word for "
    "`--checkpoint`.",
    "bucket": "The place where models, metrics and traces are stored, on this machine or at an S3 "
    "service. Its objects have keys that look like paths.",
    "calibration": "Telling the car which signal is straight ahead, full left, full right, "
    "stop, and "
    "full speed. It is done once on the car's web page.",
    "centre line": "The line in the middle of the road, given by the waypoints.",
    "checkpoint": "The weights of the network after an iteration, stored as files in the bucket.",
    "clean lap": "A lap that is completed without a reset and without a penalty. An evaluation "
    "episode of a training ends at the first violation, so if its lap is completed, it is clean.",
    "clipped PPO": "PPO: the algorithm `clipped_ppo`. It limits how much one iteration may change "
    "the policy, which keeps learning stable.",
    "clone": "A new model that starts with the weights of another one (`dr-increment-training`).",
    "collapse": "A sudden loss of what was learned: the reward falls and does not recover.",
    "COMPACT_CONVOLUTIONAL_NETWORK": "drcli's own small network, the shipped default, which learns "
    "four times as fast. The physical car takes it; DeepRacer on AWS and DeepRacer-for-Cloud do "
    "not know it: for them, `dr-export droa --distill` lets the shallow network learn from it.",
    "convergence": "The curves level off: more training hardly changes the model any more. A model "
    "has converged well when training and evaluation both complete their laps.",
    "critic": "The part of the network that predicts how much reward will still come. The policy "
    "is judged by its predictions; the car does not need it.",
    "data point": "One step as the learner sees it: camera picture, action, reward, next picture. "
    "Also called experience.",
    "DEEP_CONVOLUTIONAL_NETWORK": "The reference's largest network; slow without a GPU.",
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP": "A network of the reference with more layers, but few "
    "weights.",
    "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW": "The reference's usual network. Every system takes it.",
    "discount": "How much less a reward counts for each step that it comes later "
    "(`discount_factor`).",
    "distillation": "The second phase of a training with a teacher: a student with a camera learns "
    "to do what the teacher would do, wherever the student drives (DAgger). See "
    "`training_method`. In `dr-export droa --distill`, a network that every league takes learns "
    "from a trained model in the same way.",
    "domain randomisation": "Varying light, grip, delay and more while training, so that the model "
    "also works where the world is a little different, such as on the real track.",
    "entropy": "How undecided the policy is. High: it acts at random. Low: it is sure. It should "
    "fall slowly while a model trains.",
    "environment": "Everything around the agent: track, car, camera, reward function. Here it is "
    "the simulation.",
    "episode": "One drive, from the start until the lap is complete, the car leaves the road or "
    "crashes, or time runs out.",
    "epoch": "One pass over all steps of an iteration (`num_epochs`).",
    "epsilon": "Papers about PPO and libraries for it call the clipping range so (`clip_range`); Q "
    "learning, and here exploration of the type e-greedy, the share of random actions, which "
    "falls to `e_greedy_value` within `epsilon_steps`.",
    "eval": "The evaluation of a checkpoint: the share of the lap that it drives on average, and "
    "how many laps were clean. `...` means that it was not evaluated (yet).",
    "evaluation": "Driving without learning and without exploring, to see what a checkpoint can "
    "do.",
    "experience buffer": "The steps that were driven and not yet learned from: for PPO those of "
    "one "
    "iteration, for SAC the replay buffer.",
    "exploration": "Trying actions that do not look best, to find better ones.",
    "fast driver": "A driver of `dr-reward check` that follows the centre line at up to 3 m/s, or "
    "at the greatest speed of your actions.",
    "fence": "The check that a process still owns its model before it writes to the bucket.",
    "finished lap": "A lap that is completed, perhaps after resets, as the reference counts it. "
    "Its time has the penalties: 12.80 s = 7.80 driven + 5.00 penalty.",
    "first-lap": "The first checkpoint that drove a clean evaluation lap. A word for "
    "`--checkpoint`.",
    "frame": "One camera picture, 160 x 120 grey pixels.",
    "free tier": "What Amazon gives new customers without charge for a time. Spot "
    "machines cost money after it: `dr-spot prices` shows how much, and `DR_MAX_COST` limits it. "
    "A training on your own machine costs nothing.",
    "frozen graph": "The policy as one file that can only drive (`model.pb`). The physical car "
    "reads "
    "this form.",
    "generalisation": "How well a model drives where it was not trained: on another track, in "
    "other "
    "light, with less grip.",
    "gradient": "The direction in which a change of the weights helps most.",
    "horizon": "How many steps ahead the car plans: about 1 / (1 - discount_factor).",
    "hyperparameter": "A number that says how to learn, not what: learning rate, batch size and so "
    "on. They are in `hyperparameters.json`.",
    "iteration": "Driving `num_episodes_between_training` episodes with one checkpoint, and "
    "learning "
    "the next checkpoint from them.",
    "KL divergence": "How much the policy has changed. A large value warns that an update went too "
    "far.",
    "lap complete": "The end of an episode whose lap is done (`lap_complete` in traces), clean or "
    "with resets.",
    "last": "The newest checkpoint. A word for `--checkpoint`.",
    "latency": "The time from the camera picture to the movement of the wheels.",
    "leaderboard": "The ranking of a race: the model with the fastest laps is first. Races at "
    "home have one (`dr-race show`); those of DeepRacer on AWS take models by `dr-droa import`.",
    "lease": "A note in the bucket that says which machine trains a model. It expires a minute "
    "after "
    "that machine is gone.",
    "leaving driver": "A driver of `dr-reward check` that leaves the road: what it earns should "
    "be less than a lap.",
    "limit": "The lap time that the car cannot beat on a track (`dr docs track-limit`). `50 % "
    "above the limit` takes one and a half times as long.",
    "local optimum": "A habit that is better than everything close to it, but not good: the car is "
    "stuck with it.",
    "loss": "What the learner makes smaller: how wrong the critic is, and how little the policy "
    "does of what worked.",
    "loss p/v": "Losses of the newest update, of the policy and of the value function (critic). "
    "The second should fall; the first stays near 0.",
    "low-grip": "A simulated car (`DR_SIM_CAR`) for models from before release 6 that leave the "
    "track with the usual one.",
    "machine hours": "Hours of all starts of a training, on all machines together; with their "
    "price, what it cost.",
    "median": "The middle of all values: half of the laps are faster. One very slow lap does not "
    "change it, other than a mean.",
    "metadata": "`model_metadata.json`: actions, sensors, network and algorithm of a model.",
    "minibatch": "The steps from which the weights are changed once (`batch_size`).",
    "model": "Everything below one prefix in the bucket: checkpoints, the racer's files, "
    "metrics and "
    "traces.",
    "NaN": "Not a number: a calculation went wrong, for example because the learning rate is too "
    "high. Weights with NaN cannot drive.",
    "neural network": "The function with millions of weights that turns a camera picture into the "
    "probabilities of actions.",
    "off track": "No wheel is on the road; the episode ends.",
    "optimizer": "The part of the trainer that changes the weights; here Adam. It has a memory, "
    "which is stored with the checkpoint.",
    "out of memory": "A program wanted more memory than there is, and Linux ended it (code 137, "
    "SIGKILL, OOM). A training watches its memory and warns; fewer "
    "`DR_WORKERS` or a smaller `batch_size` need less. On a GPU, CUDA says it.",
    "over-fitting": "Learning the training track by heart, with its background and its light, "
    "instead of how to drive.",
    "overfitting": "The same as over-fitting: learning the training track by heart. It shows in "
    "evaluations on other tracks (`DR_TRAIN_EVAL_WORLD`).",
    "policy": "The function that chooses actions: the part of the network that drives.",
    "PPO": "Proximal policy optimization, the algorithm `clipped_ppo`: stable, and the default.",
    "prefix": "The name of a model in the bucket, such as `team/model-3`.",
    "progress": "How much of the lap is done, in percent.",
    "queue": "Submissions of a race that have not been driven yet. `dr-race run` drives them one "
    "after the other.",
    "racing line": "The path round the track that allows the fastest lap.",
    "ramming driver": "A driver of `dr-reward check` that drives into what is on the road.",
    "real-time factor": "Simulated time divided by real time. drcli simulates fixed steps, so lap "
    "times do not depend on it.",
    "release-6": "The usual simulated car (`DR_SIM_CAR`): as in the reference's release 6.",
    "replay buffer": "The last steps that SAC learns from, again and again.",
    "return": "The sum of all rewards of an episode from a step on, later ones discounted.",
    "reward": "The number that the reward function returns for a step.",
    "reward function": "Your function that says how good a step was. It is only needed to train; "
    "the physical car does not use it.",
    "reward shaping": "Writing a reward function that leads to the goal in small steps, instead of "
    "paying only at the end.",
    "rollout": "The recorded episodes of an iteration.",
    "RTF": "The real-time factor: simulated time divided by real time. The reference's cars act "
    "late when it falls below 1; drcli simulates fixed steps, so nothing depends on it.",
    "SAC": "Soft actor-critic, the algorithm `sac`: for continuous actions only. It needs fewer "
    "steps and reacts more to its hyperparameters than PPO.",
    "seed": "A number that decides everything random. Equal seeds give equal trainings.",
    "sim-to-real gap": "The difference between simulation and reality, because of which a model "
    "that "
    "is perfect here may fail on the car.",
    "sim2real": "From simulation to reality: training here so that the physical car drives well "
    "(`dr-init --preset physical`, `dr docs sim-to-real`).",
    "SIM_TRACE_LOG": "The beginning of a line in the log of a worker with one step of the car. "
    "`dr docs logs` has its columns.",
    "simulation worker": "A process that drives cars in the simulation and records their steps.",
    "snaking": "The car swings from side to side on a straight. Pay for less "
    "steering, or use fewer and smaller steering angles; `dr-analyze` finds it.",
    "standing driver": "A driver of `dr-reward check` that asks for the least speed: standing "
    "still should not pay.",
    "steady driver": "A driver of `dr-reward check` that follows the centre line at 1.2 m/s, or "
    "at the nearest speed of your actions.",
    "step": "One decision of the car, 15 of them per simulated second.",
    "steps/s": "How many steps all cars together drive in a real second, with the time for "
    "learning. The car makes 15 in a simulated second.",
    "student": "The camera policy while it learns from a teacher.",
    "submission": "A checkpoint that takes part in a race (`dr-race submit`).",
    "supervisor": "The process that starts the workers of a training, watches them and ends them.",
    "teacher": "A policy that sees the track instead of the camera: where the car is, and how the "
    "road goes on. It learns within a minute, drives only in the simulation, and shows a student "
    "what to do (`training_method`, `dr docs teacher`).",
    "three-laps": "The first checkpoint with three clean evaluation laps. A word for "
    "`--checkpoint`.",
    "throttle": "How much power the motor gets. The physical car turns the speed of an action "
    "into a "
    "throttle; it does not measure speed.",
    "trace": "A table of every step that was driven (simtrace), for analysis.",
    "trainer": "The process that learns from the recorded steps and writes checkpoints.",
    "training data": "All steps that a model has learned from.",
    "turned driver": "A driver of `dr-reward check` that follows the centre line in the wrong "
    "direction.",
    "value": "What the critic predicts: the rewards that will still come.",
    "waypoint": "A point on the centre line. A track has a list of them, in driving direction.",
    "weaving driver": "A driver of `dr-reward check` that swings from border to border at 1 m/s.",
    "weights": "The numbers inside the network. Learning changes them.",
    "worker": "A process of a training: a simulation worker or the trainer.",
    "zigzag": "A curve that jumps up and down, or a car that swings from side to side. Lower `lr` "
    "against the first; pay for less steering, or less for time on the road, against the second.",
}


# Error texts of DeepRacer-for-Cloud, the console and the car, with answers.
#
# docs/troubleshooting.md lists them. drcli says most of them in other words: docs/errors.md.


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
        "`dr console start` starts without a training, and shows its workers as soon as they drive",
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
        "unrecognized runtime name: nvidia",
        "Docker does not know the runtime of NVIDIA's container toolkit, which the reference's "
        "trainer needs",
        "drcli needs no Docker and no GPU; `dr-doctor` says whether it uses one",
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


# What the exit codes of all commands mean; for docs/commands.md too.


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


# The columns of a simtrace, also for docs/glossary.md.


TRACE_COLUMNS: Mapping[str, str] = {
    "episode": "Number of the episode in this training or evaluation, from 0.",
    "steps": "Number of the step in the episode, from 1. In step 1 the car is put on the road.",
    "X": "Position of a point at the front of the car, metres.",
    "Y": "Position of a point at the front of the car, metres.",
    "yaw": "Direction in which the car points, degrees.",
    "steer": "Requested steering angle, degrees, left is positive.",
    "throttle": "Requested speed, m/s. The name is older than its meaning.",
    "action": "Number of the action, from 0; of continuous actions, steering and speed in "
    "brackets.",
    "reward": "What the reward function returned for this step.",
    "done": "True in the last step of the episode.",
    "all_wheels_on_track": "True if all four wheels are on the road.",
    "progress": "Share of the lap that is done, percent.",
    "closest_waypoint": "Number of the nearest waypoint.",
    "track_len": "Length of the centre line, metres.",
    "tstamp": "Simulated time, seconds.",
    "episode_status": "How it goes: prepare, in_progress, lap_complete, off_track, crashed, "
    "immobilized, reversed, pause, park or time_up.",
    "pause_duration": "Seconds of a penalty that are left.",
    "obstacle_crash_counter": "Crashes into objects in this episode.",
    "wall_clock": "Time of day, seconds since 1970.",
    "reward_ms": "How long the call of the reward function took, milliseconds; 0 in steps without "
    "a call. Traces of DeepRacer-for-Cloud do not have this column.",
}
