"""The rules by number."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    """What a rule is about.

    Attributes:
        number: As in reports.
        subject: What it checks.
        demand: What it demands, as the documentation says it.
        breach: What a breach leads to.
        known: Whether the reference's tools have a rule of this number.
    """

    number: str
    subject: str
    demand: str
    breach: str
    known: bool = True


RULES: tuple[Rule, ...] = (
    Rule(
        "V-01",
        "settings",
        "the last part of the model's and the upload's prefix has at most 64 letters, digits and "
        "hyphens: other names cannot be imported elsewhere",
        "warning; error for the console",
    ),
    Rule(
        "V-02",
        "reward",
        "`reward_function.py` exists, compiles, and can be imported",
        "error",
    ),
    Rule(
        "V-03",
        "metadata",
        "`model_metadata.json` exists, is one JSON object, and every key is known",
        "error; keys that are not used: warning",
    ),
    Rule(
        "V-04",
        "hyperparameters",
        "`hyperparameters.json` exists, is one JSON object, and every key is known",
        "error; keys of the reference's trainer process: warning",
    ),
    Rule(
        "V-05",
        "settings",
        "`DR_WORLD_NAME` is exactly the name of a track",
        "error with the closest name; a community track that is not installed yet: note, and a "
        "start offers to fetch it (`DR_TRACKS_FETCH`)",
    ),
    Rule(
        "V-06",
        "settings",
        "X servers, displays and GPUs of containers need no settings here",
        "warning",
    ),
    Rule(
        "V-07",
        "settings",
        "`DR_RACE_TYPE` is TIME_TRIAL, OBJECT_AVOIDANCE or HEAD_TO_BOT (HEAD_TO_MODEL in "
        "evaluations), and its obstacles or bots have room on the track",
        "error",
    ),
    Rule(
        "V-08",
        "settings",
        "`DR_CAR_COLOR` is one of seven colours, in any letter case",
        "warning: it only shows in videos",
    ),
    Rule(
        "V-09",
        "bucket",
        "there is nothing under `DR_LOCAL_S3_MODEL_PREFIX`; models that merely start with the "
        "same name do not matter",
        "note; a start without `-w` or `--resume` refuses",
    ),
    Rule(
        "V-10",
        "bucket",
        "the model to start from has the chosen checkpoint, complete",
        "error",
    ),
    Rule(
        "V-11",
        "report",
        "with errors the exit code is 3; `--force` makes it 0; no questions are asked",
        "-",
    ),
    Rule(
        "V-12",
        "settings",
        "every setting is known, of its type and in its range, and fits the others",
        "error; names without meaning: warning",
        known=False,
    ),
    Rule(
        "V-13",
        "bucket",
        "nobody is training this run or this model already",
        "warning; a start refuses",
        known=False,
    ),
    Rule(
        "V-20",
        "reward",
        "`reward_function(params)` has exactly one parameter and returns a finite float from "
        "-1e5 to 1e5",
        "error; other numbers than float: warning; parameters with defaults: warning, error for "
        "the console",
    ),
    Rule(
        "V-21",
        "reward",
        "it works, within 5 s a call, on the start line, on the road, after half a lap, off the "
        "track and at the finish of your track, and at 155 more places",
        "error",
    ),
    Rule(
        "V-22",
        "reward",
        "no undefined names; imports at the top; no remarks from pyflakes and pycodestyle (class "
        "E without E5, E226, E261); `# noqa` silences a line",
        "undefined names: error; all else: warning, error for the console",
    ),
    Rule(
        "V-23",
        "reward",
        "imports only math, numpy, random, scipy, shapely, and does not access files",
        "error for the console, otherwise not checked",
    ),
    Rule(
        "V-24",
        "reward",
        "no `else if`; no `progress == 1`: progress runs from 0 to 100; no `steps == 0`, `steps "
        "== 1` and the like: the first call of an episode has `steps` 2",
        "error; warning; warning",
    ),
    Rule(
        "V-30",
        "metadata",
        "a list of actions has `steering_angle` and `speed` in each; `index`, if given, counts "
        "from 0",
        "error; a repeated action, indices in another order: warning",
    ),
    Rule(
        "V-31",
        "metadata",
        "ranges of actions have `low` below `high`; the physical car needs steering as far to "
        "the left as to the right",
        "error; for the physical car: warning",
    ),
    Rule(
        "V-32",
        "metadata",
        "steering within 30 degrees, speed 0.1 to 4 m/s (0.5 to 4 for ranges), 2 to 30 actions",
        "warning; error for the console",
    ),
    Rule(
        "V-33",
        "metadata",
        "sensors are known, one camera and at most one lidar; version and sectors fit",
        "error; a lidar that the physical car refuses: warning",
    ),
    Rule(
        "V-34",
        "both",
        "sac has ranges of actions; exploration and algorithm fit. More than one worker or "
        "episode with sac works here only",
        "error; what works here only: warning, error for the console",
    ),
    Rule(
        "V-35",
        "bucket",
        "weights to start from have the same actions, sensors, network and algorithm",
        "error; other values of the actions: warning",
    ),
    Rule(
        "V-36",
        "metadata",
        "network and type of actions are known",
        "error",
        known=False,
    ),
    Rule(
        "V-40",
        "hyperparameters",
        "`batch_size` is 32, 64, 128, 256 or 512; 34 is probably 32",
        "warning; below 1: error",
    ),
    Rule(
        "V-41",
        "hyperparameters",
        "`num_epochs` 3 to 10, `lr` 1e-8 to 1e-3, `beta_entropy` and `discount_factor` 0 to 1, "
        "`num_episodes_between_training` 1 to 100",
        "error; other epochs, fewer than 5 episodes: warning",
    ),
    Rule(
        "V-42",
        "both",
        "(`num_episodes_between_training` / `DR_WORKERS`) x `DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST` "
        "is 1",
        "warning with the fix; here starts are balanced anyway",
    ),
    Rule(
        "V-43",
        "hyperparameters",
        "`loss_type` is `huber` or `mean squared error`",
        "error",
    ),
    Rule(
        "V-44",
        "hyperparameters",
        "`term_cond_max_episodes`, which counts iterations, is 100 or more; "
        "`term_cond_avg_score`, which has no effect, is one of the usual values",
        "warning",
    ),
    Rule(
        "V-45",
        "both",
        "the number of workers divides the number of episodes and is not larger; every "
        "`worker-N.env` exists",
        "error; an uneven division: warning",
    ),
    Rule(
        "V-46",
        "hyperparameters",
        "all other keys are of their type and in their range",
        "error; unusual: warning",
        known=False,
    ),
    Rule(
        "V-50",
        "machine",
        "the bucket can be written, read, listed and deleted in; clock, disk, memory and GPU "
        "memory suffice",
        "bucket: error; all else: warning",
    ),
)
"""Every rule that a report may name."""
