"""Keys of all objects in the bucket: functions from a model's prefix to keys and back.

The DeepRacer consoles write the same layout under a model prefix, and analysis tools read it. Our
own are the tensor files of checkpoints, the `logs` folder, and the rollouts, which are outside the
model prefix because tools list that prefix often.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from drcli.exchange.checkpoint import CHECKPOINT_NAME, CheckpointName

REWARD_FUNCTION_FILE = "reward_function.py"
MODEL_METADATA_FILE = "model_metadata.json"
HYPERPARAMETERS_FILE = "hyperparameters.json"

_PREFIX = re.compile(r"[A-Za-z0-9._-]+(/[A-Za-z0-9._-]+)*")
_STAMP = re.compile(r"\d{14}")


def is_valid_prefix(prefix: str) -> bool:
    """Whether a model may have this name: tools use it as a regular expression."""
    return _PREFIX.fullmatch(prefix) is not None and not {".", ".."} & set(prefix.split("/"))


def folder(prefix: str) -> str:
    """The prefix with a slash at its end, so that a listing of model-1 leaves model-10 out."""
    return prefix.rstrip("/") + "/"


def _in_model(path: str) -> Callable[[str], str]:
    """A function from a model's prefix to the key of this object below it."""
    return lambda prefix: folder(prefix) + path


# Files of the racer, copied into the model.

model_metadata = _in_model("model/model_metadata.json")
"""Action space, sensors and network."""

hyperparameters = _in_model("ip/hyperparameters.json")
"""With all values filled in."""

reward_function = _in_model(REWARD_FUNCTION_FILE)


def parameter_file(prefix: str, name: str) -> str:
    """A parameter file of the run, such as `training_params.yaml`."""
    return folder(prefix) + name


# Results of training and evaluation.

metrics_prefix = _in_model("metrics")
"""Default folder of the metrics."""

history = _in_model("metrics/history.json")
"""The learning curve: one record for each iteration."""

learner_metrics = _in_model("metrics/learner.csv")
"""The learner's numbers of each iteration, for pandas and dashboards."""

rollbacks = _in_model("metrics/rollbacks.json")
"""How often the training went back to an older checkpoint; missing if never."""

training_start = _in_model("ip/run.json")
"""How the training was last started, such as its seed."""

curriculum = _in_model("ip/curriculum.json")
"""The stages of the training, with all files that they name."""

finished = _in_model("model/.finished")
"""Written by the trainer at its end, with the start of the training that ended."""


def training_metrics(metrics: str, worker: int = 0) -> str:
    """Training metrics of one simulation worker, below the metrics prefix."""
    name = "TrainingMetrics.json" if worker == 0 else f"TrainingMetrics_{worker}.json"
    return folder(metrics) + name


def part(key: str, number: int) -> str:
    """A part of an object that grows, with some of its entries; see `growing_file`."""
    return f"{key}.part-{number:06d}"


def part_number(key: str, part_key: str) -> int | None:
    """The number of a part of this object; None for other keys."""
    number = part_key.removeprefix(f"{key}.part-")
    return int(number) if number != part_key and number.isdecimal() else None


def is_part(key: str) -> bool:
    """Whether this is a part of an object that grows."""
    return re.search(r"\.part-\d+$", key) is not None


def evaluation_metrics(metrics: str, stamp: str) -> str:
    """Metrics of one stand-alone evaluation, below the metrics prefix."""
    return f"{evaluation_metrics_folder(metrics)}evaluation-{_checked_stamp(stamp)}.json"


def evaluation_metrics_folder(metrics_prefix: str) -> str:
    """Folder with the metrics of stand-alone evaluations."""
    return f"{folder(metrics_prefix)}evaluation/"


def robust_result(metrics: str, stamp: str) -> str:
    """Result of one robust evaluation, below the metrics prefix."""
    return f"{folder(metrics)}robust/robust-{_checked_stamp(stamp)}.json"


def best_laps(metrics: str) -> str:
    """The table of best laps of `dr-evaluate --loop`, below the metrics prefix."""
    return f"{folder(metrics)}best-laps.json"


def comparison(stamp: str) -> str:
    """The table of several models on several tracks."""
    return f"comparisons/comparison-{_checked_stamp(stamp)}.json"


def training_trace(prefix: str, iteration: int, *, worker: int = 0, workers: int = 1) -> str:
    """The steps of one worker in one iteration.

    With several `workers`, each has a folder; those that join a training of one have one, too.
    """
    return f"{training_traces_folder(prefix, worker, workers)}{iteration}-iteration.csv"


def training_traces_folder(prefix: str, worker: int, workers: int) -> str:
    """Folder with the steps of one worker in all iterations."""
    of_worker = "" if workers == 1 and worker == 0 else f"{worker}/"
    return f"{folder(prefix)}{of_worker}training-simtrace/"


def training_traces(prefix: str, iteration: int, worker: int) -> list[str]:
    """Where the steps of a worker may be, whoever else drove: the first that exists counts."""
    places = [training_trace(prefix, iteration, worker=worker, workers=count) for count in (2, 1)]
    return list(dict.fromkeys(places))


def evaluation_trace(prefix: str, stamp: str, index: int = 0) -> str:
    """The steps of one stand-alone evaluation."""
    name = f"evaluation-{_checked_stamp(stamp)}"
    return f"{folder(prefix)}{name}/evaluation-simtrace/{index}-iteration.csv"


def recording_of(trace: str) -> str:
    """What a trace of an evaluation does not tell; it lies beside the folder of the trace."""
    return trace.rpartition("evaluation-simtrace/")[0] + "recording.json"


def opponent_trace(prefix: str) -> str:
    """The steps of a model in the last race in which it was the opponent."""
    return f"{folder(prefix)}evaluation-simtrace/0-iteration.csv"


def opponent_metrics(metrics: str, stamp: str) -> str:
    """Metrics of a model as an opponent, below its metrics prefix."""
    return f"{folder(metrics)}EvaluationMetrics-{_checked_stamp(stamp)}.json"


def video(prefix: str, camera: str, index: int = 0) -> str:
    """A video of one camera: `camera-pip`, `camera-45degree` or `camera-topview`."""
    return f"{folder(prefix)}mp4/{camera}/{index}-video.mp4"


def log(prefix: str, kind: str, file: str) -> str:
    """A log of one process of the run, by the name of its file; each kind has its own folder."""
    return f"{folder(prefix)}logs/{kind}/{file}"


def event_folder(prefix: str) -> str:
    """Folder of the TensorBoard event files."""
    return f"{folder(prefix)}tensorboard/"


def event_file(prefix: str, name: str) -> str:
    """A TensorBoard event file, by the name that it has on the machine that wrote it."""
    return event_folder(prefix) + name


def evaluation_video(prefix: str, stamp: str) -> str:
    """The video of one stand-alone evaluation, which a later one does not replace."""
    return f"{folder(prefix)}evaluation-{_checked_stamp(stamp)}/video.mp4"


# State of a run while it goes on. It is outside the model: a copy of the model must not look as if
# it were being trained.


def run_folder(prefix: str) -> str:
    """Folder of this state."""
    return f"runs/{folder(prefix)}"


def lease(prefix: str) -> str:
    """Says which process trains on this prefix."""
    return run_folder(prefix) + "lease.json"


def outcome(prefix: str) -> str:
    """What the newest start of the run came to."""
    return run_folder(prefix) + "outcome.json"


def spending_folder(prefix: str) -> str:
    """Folder with what each start of the training has cost."""
    return run_folder(prefix) + "spending/"


def spending(prefix: str, term: int, session: str) -> str:
    """What one start has cost."""
    return f"{spending_folder(prefix)}{term:06d}-{session}.json"


def journal_folder(prefix: str) -> str:
    """Folder with the journal of the model: one object for each start."""
    return folder(prefix) + "journal/"


def journal(prefix: str, term: int, session: str) -> str:
    """What happened in one start; sorted by key, the starts are in their order."""
    return f"{journal_folder(prefix)}{term:06d}-{session}.jsonl"


def journal_session(prefix: str, key: str) -> str | None:
    """The start whose journal this is; None for other keys."""
    found = re.fullmatch(re.escape(journal_folder(prefix)) + r"\d+-([^/]+)\.jsonl", key)
    return found[1] if found else None


def notes_folder(prefix: str) -> str:
    """Folder with what the racer wrote about the model: one object for each note."""
    return folder(prefix) + "notes/"


def note(prefix: str, name: str) -> str:
    """A note; sorted by key, the notes are in their order."""
    return f"{notes_folder(prefix)}{name}.json"


def training_records_folder(prefix: str = "") -> str:
    """Folder with the records of the trainings of a model, or of all models.

    It is outside the models: the records stay when a model is deleted.
    """
    return f"training-records/{folder(prefix)}" if prefix else "training-records/"


def training_record(prefix: str, training: str) -> str:
    """The record of one training."""
    return f"{training_records_folder(prefix)}{training}.json"


def training_files(prefix: str, training: str) -> str:
    """The files of one training."""
    return f"{training_records_folder(prefix)}{training}.files.json"


def training_of(key: str) -> tuple[str, str] | None:
    """The model and the id of the training whose record this is; None for other keys."""
    found = re.fullmatch(r"training-records/(.+)/([0-9a-f]{8})\.json", key)
    return (found[1], found[2]) if found else None


def damaged_folder(prefix: str) -> str:
    """Folder of damaged objects that were moved out of the model."""
    return f"{run_folder(prefix)}damaged/"


def damaged(prefix: str, key: str, stamp: str) -> str:
    """Where a damaged object is kept, with the time as fourteen digits: no tool reads it there."""
    name = key.removeprefix(run_folder(prefix)).removeprefix(folder(prefix))
    return f"{damaged_folder(prefix)}{name}.{stamp}"


def status_folder(prefix: str) -> str:
    """Folder with the activity of each process of the run."""
    return run_folder(prefix) + "status/"


def status(prefix: str, name: str) -> str:
    """The activity of one process of the run."""
    return f"{status_folder(prefix)}{name}.json"


def join_record(prefix: str) -> str:
    """What a simulation worker elsewhere needs to join the training."""
    return run_folder(prefix) + "join.json"


def shares(prefix: str) -> str:
    """Who drives which episodes; missing until a worker has joined."""
    return run_folder(prefix) + "shares.json"


def members_folder(prefix: str) -> str:
    """Folder with the records of the simulation workers that have joined."""
    return run_folder(prefix) + "members/"


def member(prefix: str, name: str) -> str:
    """The record of a simulation worker that has joined."""
    return f"{members_folder(prefix)}{name}.json"


def member_of(prefix: str, key: str) -> str | None:
    """The name of the worker whose record this is; None for other keys."""
    found = re.fullmatch(re.escape(members_folder(prefix)) + r"([^/]+)\.json", key)
    return found[1] if found else None


def reward_errors_folder(prefix: str) -> str:
    """Folder with the failures of the reward function that each worker has counted."""
    return run_folder(prefix) + "reward-errors/"


def reward_errors(prefix: str, worker: int) -> str:
    """The failures of the reward function that one worker has counted."""
    return f"{reward_errors_folder(prefix)}{worker}.json"


def decides(key: str) -> bool:
    """Whether readers use this object directly: pointers, manifests, traces, metrics, curves.

    Tensors, parts and records are only read when such an object names them; activities, logs and
    event files are for people, and a worker writes a record of its own when it joins.
    """
    named = (".safetensors", ".ckpt.json")
    folders = ("/status/", "/logs/", "/tensorboard/", "/members/")
    return not (key.endswith(named) or any(name in key for name in folders))


# Checkpoints.

model_folder = _in_model("model/")
"""Folder of the checkpoints."""

coach_checkpoint = _in_model("model/.coach_checkpoint")
"""The pointer: plain text, exactly the name of the newest checkpoint."""

deepracer_checkpoints = _in_model("model/deepracer_checkpoints.json")
"""Names and scores of the best and the last checkpoint."""

milestones = _in_model("model/milestones.json")
"""Checkpoints that did something first or best, and those that are kept as every n-th."""


def checkpoint_tensors(prefix: str, name: str) -> str:
    """The weights of a checkpoint."""
    return f"{model_folder(prefix)}{name}.safetensors"


def checkpoint_optimizer(prefix: str, name: str) -> str:
    """The optimizer state that continues a checkpoint."""
    return f"{model_folder(prefix)}{name}.optimizer.safetensors"


def is_optimizer(key: str) -> bool:
    """Whether the object is an optimizer state."""
    return key.endswith(".ckpt.optimizer.safetensors")


def checkpoint_record(prefix: str, name: str) -> str:
    """Sizes and hashes of a checkpoint's files, and the counters to continue with."""
    return f"{model_folder(prefix)}{name}.json"


def checkpoint_graph(prefix: str, number: int) -> str:
    """The inference graph of a checkpoint, which the physical car loads."""
    return f"{model_folder(prefix)}model_{number}.pb"


TENSORFLOW_PARTS = (".index", ".meta", ".data-00000-of-00001")
"""Files of a checkpoint of the reference; all three are needed."""


def is_tensorflow_part(key: str) -> bool:
    """Whether the object is a file of a checkpoint of the reference."""
    return re.search(r"\.ckpt\.(index|meta|data-\d{5}-of-\d{5})$", key) is not None


def checkpoint_part(prefix: str, name: str, part: str) -> str:
    """One of the files of a checkpoint, by the end of its name."""
    return f"{model_folder(prefix)}{name}{part}"


def checkpoint_of(prefix: str, key: str) -> CheckpointName | None:
    """The checkpoint of this model that an object belongs to, or None."""
    start = model_folder(prefix)
    found = CHECKPOINT_NAME.match(key, len(start)) if key.startswith(start) else None
    if found is None or not key[found.end() :].startswith("."):
        return None
    return CheckpointName(int(found[1]), int(found[2]))


# Rollouts.


@dataclass(frozen=True)
class RolloutKey:
    """The key of a rollout object, read."""

    iteration: int
    worker: int
    name: str

    @property
    def is_manifest(self) -> bool:
        """Whether this is the object that names the others."""
        return self.name == "manifest.json"


def rollouts_folder(prefix: str) -> str:
    """All rollouts of a model."""
    return f"rollouts/{folder(prefix)}"


def evaluations_folder(prefix: str) -> str:
    """Evaluation results of all checkpoints."""
    return f"{run_folder(prefix)}evaluations/"


def evaluation_result(prefix: str, iteration: int) -> str:
    """The evaluation result of the checkpoint of an iteration."""
    return f"{evaluations_folder(prefix)}{iteration}.json"


def iteration_folder(prefix: str, iteration: int) -> str:
    """All rollouts of one iteration."""
    return f"{rollouts_folder(prefix)}{iteration}/"


def rollout_part(prefix: str, iteration: int, worker: int, session: str, part: int) -> str:
    """Some episodes; because of the session, a restarted worker does not overwrite old ones."""
    return f"{iteration_folder(prefix, iteration)}{worker}/{session}-{part}.safetensors"


def rollout_manifest(prefix: str, iteration: int, worker: int) -> str:
    """The list of one worker's parts in one iteration."""
    return f"{iteration_folder(prefix, iteration)}{worker}/manifest.json"


def rollout_key(prefix: str, key: str) -> RolloutKey | None:
    """Read the key of a rollout object of this model; None for other keys.

    The rollouts of a model whose prefix continues this one (`a/3` and `a`) are in deeper folders.
    """
    found = re.fullmatch(re.escape(rollouts_folder(prefix)) + r"(\d+)/(\d+)/([^/]+)", key)
    return RolloutKey(int(found[1]), int(found[2]), found[3]) if found else None


def _checked_stamp(stamp: str) -> str:
    """The stamp itself; analysis tools crash on evaluation folders with other names."""
    if _STAMP.fullmatch(stamp) is None:
        raise ValueError(f"An evaluation is named by 14 digits YYYYMMDDhhmmss, not by {stamp!r}.")
    return stamp
