"""Keys of everything in the bucket: pure functions from a model's prefix to keys and back.

The layout under a model prefix is the one that the DeepRacer consoles write and that analysis
tools read. Only what those tools never look at is our own: the checkpoint's tensor files, the
`logs` folder, and the rollouts, which lie outside the model prefix because tools list that prefix
again and again.
"""

import re
from dataclasses import dataclass

from drcli.exchange.checkpoint import CHECKPOINT_NAME, CheckpointName

REWARD_FUNCTION_FILE = "reward_function.py"
MODEL_METADATA_FILE = "model_metadata.json"
HYPERPARAMETERS_FILE = "hyperparameters.json"

_PREFIX = re.compile(r"[A-Za-z0-9._-]+(/[A-Za-z0-9._-]+)*")
_STAMP = re.compile(r"\d{14}")


def is_valid_prefix(prefix: str) -> bool:
    """Whether a model may be called so: tools use the prefix as a regular expression."""
    return _PREFIX.fullmatch(prefix) is not None and not {".", ".."} & set(prefix.split("/"))


def folder(prefix: str) -> str:
    """The prefix with one slash at its end, so that a listing of model-1 leaves model-10 out."""
    return prefix.rstrip("/") + "/"


# Files the user brings.


def model_metadata(prefix: str) -> str:
    """The model's own copy of its action space, sensors and network."""
    return folder(prefix) + "model/model_metadata.json"


def hyperparameters(prefix: str) -> str:
    """The model's own copy of its hyperparameters, all values filled in."""
    return folder(prefix) + "ip/hyperparameters.json"


def reward_function(prefix: str) -> str:
    """The model's own copy of the reward function it is trained with."""
    return folder(prefix) + REWARD_FUNCTION_FILE


def parameter_file(prefix: str, name: str) -> str:
    """The run's parameter file, for instance `training_params.yaml`."""
    return folder(prefix) + name


# What training and evaluation write.


def metrics_prefix(prefix: str) -> str:
    """Where metrics lie unless the settings say otherwise."""
    return folder(prefix) + "metrics"


def training_metrics(metrics: str, worker: int = 0) -> str:
    """Training metrics of one simulation worker, below the metrics prefix."""
    name = "TrainingMetrics.json" if worker == 0 else f"TrainingMetrics_{worker}.json"
    return folder(metrics) + name


def history(prefix: str) -> str:
    """The learning curve of the run, one record an iteration."""
    return metrics_prefix(prefix) + "/history.json"


def learner_metrics(prefix: str) -> str:
    """The learner's numbers of each iteration, for pandas and dashboards."""
    return metrics_prefix(prefix) + "/learner.csv"


def training_start(prefix: str) -> str:
    """What the last start of the training was started with, such as its seed."""
    return folder(prefix) + "ip/run.json"


def finished(prefix: str) -> str:
    """Says that the trainer has ended the training, and which start of it that was."""
    return folder(prefix) + "model/.finished"


def evaluation_metrics(metrics: str, stamp: str) -> str:
    """Metrics of one stand-alone evaluation, below the metrics prefix."""
    return f"{folder(metrics)}evaluation/evaluation-{_checked_stamp(stamp)}.json"


def training_trace(prefix: str, iteration: int, *, worker: int = 0, workers: int = 1) -> str:
    """The steps of one worker in one iteration; a lone worker has no folder of its own."""
    own = "" if workers == 1 else f"{worker}/"
    return f"{folder(prefix)}{own}training-simtrace/{iteration}-iteration.csv"


def evaluation_trace(prefix: str, stamp: str, index: int = 0) -> str:
    """The steps of one stand-alone evaluation."""
    name = f"evaluation-{_checked_stamp(stamp)}"
    return f"{folder(prefix)}{name}/evaluation-simtrace/{index}-iteration.csv"


def opponent_trace(prefix: str) -> str:
    """The steps of a model that was last raced against as the opponent; overwritten by the next."""
    return f"{folder(prefix)}evaluation-simtrace/0-iteration.csv"


def opponent_metrics(metrics: str, stamp: str) -> str:
    """Metrics of a model that was raced against, below its metrics prefix."""
    return f"{folder(metrics)}EvaluationMetrics-{_checked_stamp(stamp)}.json"


def video(prefix: str, camera: str, index: int = 0) -> str:
    """A film of one camera: `camera-pip`, `camera-45degree` or `camera-topview`."""
    return f"{folder(prefix)}mp4/{camera}/{index}-video.mp4"


def log(prefix: str, kind: str, name: str) -> str:
    """A log file of one process of the run; each kind of process has a folder of its own."""
    return f"{folder(prefix)}logs/{kind}/{name}.log"


# What is true of a run only while it runs, and so lies outside the model: a copy of a model must
# not look as if it were in training.


def run_folder(prefix: str) -> str:
    """All of it."""
    return f"runs/{folder(prefix)}"


def lease(prefix: str) -> str:
    """Who trains on this prefix now."""
    return run_folder(prefix) + "lease.json"


def damaged(prefix: str, key: str, stamp: str) -> str:
    """Where a damaged object of a model is kept: no tool takes what ends so for a part of one.

    Args:
        prefix: The model.
        key: Where the object lay.
        stamp: When it was put aside, fourteen digits.
    """
    own = key.removeprefix(run_folder(prefix)).removeprefix(folder(prefix))
    return f"{run_folder(prefix)}damaged/{own}.{stamp}"


def status_folder(prefix: str) -> str:
    """What each process of the run is doing."""
    return run_folder(prefix) + "status/"


def status(prefix: str, name: str) -> str:
    """What one process of the run is doing."""
    return f"{status_folder(prefix)}{name}.json"


def decides(key: str) -> bool:
    """Whether readers go by this object alone: pointers, manifests, traces, metrics, curves.

    Tensors, parts and records mean nothing before such an object names them; what a process is
    doing, and logs, are for people.
    """
    named = (".safetensors", ".ckpt.json")
    return not (key.endswith(named) or "/status/" in key or "/logs/" in key)


# Checkpoints.


def model_folder(prefix: str) -> str:
    """Where checkpoints lie."""
    return folder(prefix) + "model/"


def coach_checkpoint(prefix: str) -> str:
    """The pointer: plain text, exactly the name of the newest checkpoint."""
    return model_folder(prefix) + ".coach_checkpoint"


def deepracer_checkpoints(prefix: str) -> str:
    """Names and scores of the best and the last checkpoint."""
    return model_folder(prefix) + "deepracer_checkpoints.json"


def checkpoint_tensors(prefix: str, name: str) -> str:
    """The weights of a checkpoint."""
    return f"{model_folder(prefix)}{name}.safetensors"


def checkpoint_optimizer(prefix: str, name: str) -> str:
    """The optimizer state that continues a checkpoint."""
    return f"{model_folder(prefix)}{name}.optimizer.safetensors"


def is_optimizer(key: str) -> bool:
    """Whether the key is that of an optimizer state."""
    return key.endswith(".ckpt.optimizer.safetensors")


def checkpoint_record(prefix: str, name: str) -> str:
    """Sizes and hashes of a checkpoint's files and the counters to continue with."""
    return f"{model_folder(prefix)}{name}.json"


def checkpoint_graph(prefix: str, number: int) -> str:
    """The inference graph of checkpoint `number`, as the physical car takes it."""
    return f"{model_folder(prefix)}model_{number}.pb"


TENSORFLOW_PARTS = (".index", ".meta", ".data-00000-of-00001")
"""What the reference's checkpoints are made of; all three are needed."""


def checkpoint_part(prefix: str, name: str, part: str) -> str:
    """One of the files of a checkpoint, by what follows its name."""
    return f"{model_folder(prefix)}{name}{part}"


def checkpoint_of(prefix: str, key: str) -> CheckpointName | None:
    """The checkpoint that a key of this model's folder belongs to, None for other keys."""
    start = model_folder(prefix)
    found = CHECKPOINT_NAME.match(key, len(start)) if key.startswith(start) else None
    if found is None or not key[found.end() :].startswith("."):
        return None
    return CheckpointName(int(found[1]), int(found[2]))


# Rollouts.


@dataclass(frozen=True)
class RolloutKey:
    """What the key of a rollout object says about it."""

    iteration: int
    worker: int
    name: str

    @property
    def is_manifest(self) -> bool:
        """Whether this is the small object that names the others."""
        return self.name == "manifest.json"


def rollouts_folder(prefix: str) -> str:
    """All rollouts of a model, outside its own folder."""
    return f"rollouts/{folder(prefix)}"


def evaluations_folder(prefix: str) -> str:
    """How each checkpoint did in its evaluation episodes."""
    return f"{run_folder(prefix)}evaluations/"


def evaluation_result(prefix: str, iteration: int) -> str:
    """How the checkpoint of an iteration did in its evaluation episodes."""
    return f"{evaluations_folder(prefix)}{iteration}.json"


def iteration_folder(prefix: str, iteration: int) -> str:
    """All rollouts of one iteration."""
    return f"{rollouts_folder(prefix)}{iteration}/"


def rollout_part(prefix: str, iteration: int, worker: int, session: str, part: int) -> str:
    """A batch of episodes; the session keeps a restarted worker from overwriting its old ones."""
    return f"{iteration_folder(prefix, iteration)}{worker}/{session}-{part}.safetensors"


def rollout_manifest(prefix: str, iteration: int, worker: int) -> str:
    """The list of one worker's parts of one iteration."""
    return f"{iteration_folder(prefix, iteration)}{worker}/manifest.json"


def rollout_key(prefix: str, key: str) -> RolloutKey | None:
    """Read the key of a rollout object of this model.

    Returns:
        None for other keys, among them those of a model whose prefix continues this one (`a/3`
        beside `a`): its rollouts lie deeper.
    """
    found = re.fullmatch(re.escape(rollouts_folder(prefix)) + r"(\d+)/(\d+)/([^/]+)", key)
    return RolloutKey(int(found[1]), int(found[2]), found[3]) if found else None


def _checked_stamp(stamp: str) -> str:
    """The stamp itself; analysis tools crash on evaluation folders that are named otherwise."""
    if _STAMP.fullmatch(stamp) is None:
        raise ValueError(f"An evaluation is named by 14 digits YYYYMMDDhhmmss, not by {stamp!r}.")
    return stamp
