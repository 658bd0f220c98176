"""Keys of all objects in the bucket, from a model's prefix and back.

The layout of the DeepRacer consoles, which analysis tools read. Ours are tensor files, `logs`, and
rollouts, outside the prefix because tools list it often.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from drcli.records.checkpoint import CHECKPOINT_NAME, CheckpointName

REWARD_FUNCTION_FILE = "reward_function.py"
MODEL_METADATA_FILE = "model_metadata.json"
HYPERPARAMETERS_FILE = "hyperparameters.json"

_PREFIX = re.compile(r"[A-Za-z0-9._-]+(/[A-Za-z0-9._-]+)*")
_STAMP = re.compile(r"\d{14}")
_TRACE = re.compile(r"(?:(\d+)/)?training-simtrace/(\d+)-iteration\.csv")


def is_valid_prefix(prefix: str) -> bool:
    """Tools use it as a regular expression."""
    return _PREFIX.fullmatch(prefix) is not None and not {".", ".."} & set(prefix.split("/"))


def folder(prefix: str) -> str:
    """With a slash: a listing of model-1 leaves model-10 out."""
    return prefix.rstrip("/") + "/"


def _in_model(path: str) -> Callable[[str], str]:
    return lambda prefix: folder(prefix) + path


# Files of the racer, copied into the model.

model_metadata = _in_model("model/model_metadata.json")
hyperparameters = _in_model("ip/hyperparameters.json")
reward_function = _in_model(REWARD_FUNCTION_FILE)


def parameter_file(prefix: str, name: str) -> str:
    return folder(prefix) + name


# Results of training and evaluation.

metrics_prefix = _in_model("metrics")
history = _in_model("metrics/history.json")
learner_metrics = _in_model("metrics/learner.csv")
rollbacks = _in_model("metrics/rollbacks.json")
training_start = _in_model("ip/run.json")
curriculum = _in_model("ip/curriculum.json")
finished = _in_model("model/.finished")
"""By the trainer at its end, with the start that ended."""


def training_metrics(metrics: str, worker: int = 0) -> str:
    name = "TrainingMetrics.json" if worker == 0 else f"TrainingMetrics_{worker}.json"
    return folder(metrics) + name


def part(key: str, number: int) -> str:
    return f"{key}.part-{number:06d}"


def part_number(key: str, part_key: str) -> int | None:
    number = part_key.removeprefix(f"{key}.part-")
    return int(number) if number != part_key and number.isdecimal() else None


def is_part(key: str) -> bool:
    return re.search(r"\.part-\d+$", key) is not None


def evaluation_metrics(metrics: str, stamp: str) -> str:
    return f"{evaluation_metrics_folder(metrics)}evaluation-{_checked_stamp(stamp)}.json"


def evaluation_metrics_folder(metrics_prefix: str) -> str:
    return f"{folder(metrics_prefix)}evaluation/"


def robust_result(metrics: str, stamp: str) -> str:
    return f"{folder(metrics)}robust/robust-{_checked_stamp(stamp)}.json"


def best_laps(metrics: str) -> str:
    return f"{folder(metrics)}best-laps.json"


def comparison(stamp: str) -> str:
    return f"comparisons/comparison-{_checked_stamp(stamp)}.json"


def training_trace(prefix: str, iteration: int, *, worker: int = 0, workers: int = 1) -> str:
    """Each worker has a folder, unless one drives alone."""
    return f"{training_traces_folder(prefix, worker, workers)}{iteration}-iteration.csv"


def training_traces_folder(prefix: str, worker: int, workers: int) -> str:
    of_worker = "" if workers == 1 and worker == 0 else f"{worker}/"
    return f"{folder(prefix)}{of_worker}training-simtrace/"


def training_traces(prefix: str, iteration: int, worker: int) -> list[str]:
    """Wherever they may be: the first that exists counts."""
    places = [training_trace(prefix, iteration, worker=worker, workers=count) for count in (2, 1)]
    return list(dict.fromkeys(places))


def training_trace_of(prefix: str, key: str) -> tuple[int, int] | None:
    """Iteration and worker of a trace."""
    found = _TRACE.fullmatch(key.removeprefix(folder(prefix)))
    return None if found is None else (int(found[2]), int(found[1] or 0))


def evaluation_trace(prefix: str, stamp: str, index: int = 0) -> str:
    name = f"evaluation-{_checked_stamp(stamp)}"
    return f"{folder(prefix)}{name}/evaluation-simtrace/{index}-iteration.csv"


def recording_of(trace: str) -> str:
    return trace.rpartition("evaluation-simtrace/")[0] + "recording.json"


opponent_trace = _in_model("evaluation-simtrace/0-iteration.csv")


def opponent_metrics(metrics: str, stamp: str) -> str:
    return f"{folder(metrics)}EvaluationMetrics-{_checked_stamp(stamp)}.json"


def video(prefix: str, camera: str, index: int = 0) -> str:
    return f"{folder(prefix)}mp4/{camera}/{index}-video.mp4"


def log(prefix: str, kind: str, file: str) -> str:
    return f"{folder(prefix)}logs/{kind}/{file}"


event_folder = _in_model("tensorboard/")


def event_file(prefix: str, name: str) -> str:
    return event_folder(prefix) + name


def evaluation_video(prefix: str, stamp: str) -> str:
    return f"{folder(prefix)}evaluation-{_checked_stamp(stamp)}/video.mp4"


# State of a run while it goes on. It is outside the model: a copy of the model must not look as if
# it were being trained.


def run_folder(prefix: str) -> str:
    return f"runs/{folder(prefix)}"


def _in_run(path: str) -> Callable[[str], str]:
    return lambda prefix: run_folder(prefix) + path


lease = _in_run("lease.json")


outcome = _in_run("outcome.json")


spending_folder = _in_run("spending/")


def spending(prefix: str, term: int, session: str) -> str:
    return f"{spending_folder(prefix)}{term:06d}-{session}.json"


journal_folder = _in_model("journal/")


def journal(prefix: str, term: int, session: str) -> str:
    return f"{journal_folder(prefix)}{term:06d}-{session}.jsonl"


def journal_session(prefix: str, key: str) -> str | None:
    found = re.fullmatch(re.escape(journal_folder(prefix)) + r"\d+-([^/]+)\.jsonl", key)
    return found[1] if found else None


notes_folder = _in_model("notes/")


def note(prefix: str, name: str) -> str:
    return f"{notes_folder(prefix)}{name}.json"


def training_records_folder(prefix: str = "") -> str:
    """Outside the models, which the records outlive."""
    return f"training-records/{folder(prefix)}" if prefix else "training-records/"


def training_record(prefix: str, training: str) -> str:
    return f"{training_records_folder(prefix)}{training}.json"


def training_files(prefix: str, training: str) -> str:
    return f"{training_records_folder(prefix)}{training}.files.json"


def training_of(key: str) -> tuple[str, str] | None:
    found = re.fullmatch(r"training-records/(.+)/([0-9a-f]{8})\.json", key)
    return (found[1], found[2]) if found else None


damaged_folder = _in_run("damaged/")


def damaged(prefix: str, key: str, stamp: str) -> str:
    """Where no tool reads it, with a stamp of fourteen digits."""
    name = key.removeprefix(run_folder(prefix)).removeprefix(folder(prefix))
    return f"{damaged_folder(prefix)}{name}.{stamp}"


status_folder = _in_run("status/")


def status(prefix: str, name: str) -> str:
    return f"{status_folder(prefix)}{name}.json"


join_record = _in_run("join.json")


shares = _in_run("shares.json")
"""Missing until a worker has joined."""


members_folder = _in_run("members/")


def member(prefix: str, name: str) -> str:
    return f"{members_folder(prefix)}{name}.json"


def member_of(prefix: str, key: str) -> str | None:
    found = re.fullmatch(re.escape(members_folder(prefix)) + r"([^/]+)\.json", key)
    return found[1] if found else None


reward_errors_folder = _in_run("reward-errors/")


def reward_errors(prefix: str, worker: int) -> str:
    return f"{reward_errors_folder(prefix)}{worker}.json"


def decides(key: str) -> bool:
    """Whether readers use it directly: pointers, manifests, traces, metrics, curves.

    These name tensors, parts and records; the rest is for people.
    """
    named = (".safetensors", ".ckpt.json")
    folders = ("/status/", "/logs/", "/tensorboard/", "/members/")
    return not (key.endswith(named) or any(name in key for name in folders))


# Checkpoints.

model_folder = _in_model("model/")
coach_checkpoint = _in_model("model/.coach_checkpoint")
"""Exactly the newest checkpoint's name, plain text."""

deepracer_checkpoints = _in_model("model/deepracer_checkpoints.json")
milestones = _in_model("model/milestones.json")


def checkpoint_tensors(prefix: str, name: str) -> str:
    return f"{model_folder(prefix)}{name}.safetensors"


def checkpoint_optimizer(prefix: str, name: str) -> str:
    return f"{model_folder(prefix)}{name}.optimizer.safetensors"


def is_optimizer(key: str) -> bool:
    return key.endswith(".ckpt.optimizer.safetensors")


def checkpoint_record(prefix: str, name: str) -> str:
    return f"{model_folder(prefix)}{name}.json"


def checkpoint_graph(prefix: str, number: int) -> str:
    return f"{model_folder(prefix)}model_{number}.pb"


TENSORFLOW_PARTS = (".index", ".meta", ".data-00000-of-00001")
"""The reference needs all."""


def is_tensorflow_part(key: str) -> bool:
    return re.search(r"\.ckpt\.(index|meta|data-\d{5}-of-\d{5})$", key) is not None


def checkpoint_part(prefix: str, name: str, part: str) -> str:
    return f"{model_folder(prefix)}{name}{part}"


def checkpoint_of(prefix: str, key: str) -> CheckpointName | None:
    start = model_folder(prefix)
    found = CHECKPOINT_NAME.match(key, len(start)) if key.startswith(start) else None
    if found is None or not key[found.end() :].startswith("."):
        return None
    return CheckpointName(int(found[1]), int(found[2]))


# Rollouts.


@dataclass(frozen=True)
class RolloutKey:
    iteration: int
    worker: int
    name: str

    @property
    def is_manifest(self) -> bool:
        return self.name == "manifest.json"


def rollouts_folder(prefix: str) -> str:
    return f"rollouts/{folder(prefix)}"


evaluations_folder = _in_run("evaluations/")


def evaluation_result(prefix: str, iteration: int) -> str:
    return f"{evaluations_folder(prefix)}{iteration}.json"


def iteration_folder(prefix: str, iteration: int) -> str:
    return f"{rollouts_folder(prefix)}{iteration}/"


def rollout_part(prefix: str, iteration: int, worker: int, session: str, part: int) -> str:
    """With the session: a restarted worker overwrites nothing."""
    return f"{iteration_folder(prefix, iteration)}{worker}/{session}-{part}.safetensors"


def rollout_manifest(prefix: str, iteration: int, worker: int) -> str:
    return f"{iteration_folder(prefix, iteration)}{worker}/manifest.json"


def rollout_key(prefix: str, key: str) -> RolloutKey | None:
    """None for other keys, as of `a/3` for a model `a`."""
    found = re.fullmatch(re.escape(rollouts_folder(prefix)) + r"(\d+)/(\d+)/([^/]+)", key)
    return RolloutKey(int(found[1]), int(found[2]), found[3]) if found else None


def _checked_stamp(stamp: str) -> str:
    """Analysis tools crash on other names."""
    if _STAMP.fullmatch(stamp) is None:
        raise ValueError(f"An evaluation is named by 14 digits YYYYMMDDhhmmss, not by {stamp!r}.")
    return stamp
