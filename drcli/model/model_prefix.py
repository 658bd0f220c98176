"""One model in a bucket: what lies there, newest checkpoint, deletion."""

import re
from collections.abc import Collection
from typing import Literal

from drcli.bucket.bucket import TEST_FOLDER
from drcli.model import keys
from drcli.model.checkpoints import checkpoint_objects, checkpoints_among
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName


class ModelListing:
    """What lies below a prefix, listed once; `model-10` does not count for `model-1`.

    Nor do test objects, which `dr doctor` may be writing at the moment.
    """

    def __init__(self, model: ModelStore) -> None:
        self.model = model
        self.look()

    def look(self) -> None:
        """Once more, after something was written."""
        folder = keys.folder(self.model.prefix)
        listed = self.model.bucket.list(folder)
        test = folder + TEST_FOLDER
        self.objects = {info.key: info for info in listed if not info.key.startswith(test)}
        self.checkpoints = checkpoints_among(self.model.prefix, self.objects)

    @property
    def whole(self) -> list[CheckpointName]:
        """The checkpoints of ours that have weights and record."""
        prefix = self.model.prefix
        return sorted(
            name
            for name in set(self.checkpoints.values())
            if keys.checkpoint_record(prefix, str(name)) in self.objects
            and keys.checkpoint_tensors(prefix, str(name)) in self.objects
        )

    @property
    def kind(self) -> "Kind":
        folder = keys.folder(self.model.prefix)
        return kind_of([key.removeprefix(folder) for key in self.objects])

    @property
    def has_tensorflow(self) -> bool:
        return any(map(keys.is_tensorflow_part, self.objects))

    @property
    def has_checkpoint(self) -> bool:
        """Ours or TensorFlow's, maybe damaged."""
        return any(key.endswith((".ckpt.json", ".ckpt.index")) for key in self.checkpoints)

    @property
    def traces(self) -> dict[int, dict[int, str]]:
        """Of iterations, by worker."""
        found: dict[int, dict[int, str]] = {}
        for key in self.objects:
            trace = keys.training_trace_of(self.model.prefix, key)
            if trace is not None:
                iteration, worker = trace
                found.setdefault(iteration, {})[worker] = key
        return dict(sorted(found.items()))


def is_used(model: ModelStore) -> bool:
    return bool(ModelListing(model).objects)


def newest_checkpoint(model: ModelStore) -> CheckpointName | None:
    return max(checkpoint_objects(model).values(), default=None)


def delete_unlearned(model: ModelStore) -> None:
    """Workers that drive ahead of a trainer that ended leave such an iteration."""
    newest = newest_checkpoint(model)
    if newest is None:
        return
    ahead = []
    for info in model.bucket.list(keys.rollouts_folder(model.prefix)):
        key = keys.rollout_key(model.prefix, info.key)
        if key is not None and key.iteration >= newest.number:
            ahead.append(info.key)
    model.bucket.delete(ahead)


def contains(outer: str, inner: str) -> bool:
    return keys.folder(inner).startswith(keys.folder(outer))


def wipe(model: ModelStore, *, spared: Collection[str] = ()) -> None:
    for folder in (
        keys.folder(model.prefix),
        keys.rollouts_folder(model.prefix),
        keys.run_folder(model.prefix),
    ):
        model.bucket.delete(
            [item.key for item in model.bucket.list(folder) if item.key not in spared]
        )


def is_aborted_start(listed: ModelListing, parameter_files: Collection[str]) -> bool:
    """Whether there is only what a start wrote before its checkpoint.

    A new start may overwrite that.
    """
    model = listed.model
    known = {
        keys.reward_function(model.prefix),
        keys.model_metadata(model.prefix),
        keys.hyperparameters(model.prefix),
        keys.training_start(model.prefix),
        keys.curriculum(model.prefix),
        *(keys.parameter_file(model.prefix, name) for name in parameter_files),
    }
    folders = (
        f"{keys.folder(model.prefix)}logs/",
        keys.event_folder(model.prefix),
        keys.journal_folder(model.prefix),
        keys.notes_folder(model.prefix),
    )
    unfinished = listed.checkpoints
    if any(
        name.number or key.endswith(".ckpt.json") or keys.is_tensorflow_part(key)
        for key, name in unfinished.items()
    ):
        return False
    ours = keys.training_start(model.prefix) in listed.objects or model.bucket.exists(
        keys.outcome(model.prefix)
    )
    return ours and all(
        key in known or key in unfinished or key.startswith(folders) for key in listed.objects
    )


# What lies below a prefix, and which command works on it.


Kind = Literal["drcli", "tensorflow", "upload", "traces", "files", "nothing"]
"""A lone policy is "upload"; traces or metrics without a checkpoint are "traces"."""

_OURS = re.compile(r"model/\d+_Step-\d+\.ckpt\.(safetensors|json)")
_TENSORFLOW = re.compile(r"model/\d+_Step-\d+\.ckpt\.(index|data-\d{5}-of-\d{5})")
_POLICY = re.compile(r"([^/]+/)?[^/]+\.(pb|onnx|ckpt\.index)")
_TRACES = re.compile(r"(.*/)?(training|evaluation)-simtrace/[^/]+\.csv|metrics/.+\.json")


def kind_of(names: Collection[str]) -> Kind:
    for pattern, kind in _PATTERNS:
        if any(map(pattern.fullmatch, names)):
            return kind
    return "files" if names else "nothing"


_PATTERNS: tuple[tuple[re.Pattern[str], Kind], ...] = (
    (_OURS, "drcli"),
    (_TENSORFLOW, "tensorflow"),
    (_POLICY, "upload"),
    (_TRACES, "traces"),
)


def is_tensorflow(listed: Collection[str], prefix: str, name: str) -> bool:
    """Whether a checkpoint is only the reference's, by the listed keys.

    Ours have their record last, so weights without it do not count.
    """
    index = keys.checkpoint_part(prefix, name, ".index")
    return index in listed and keys.checkpoint_record(prefix, name) not in listed


KIND_WORDS: dict[Kind, str] = {
    "drcli": "a model of drcli",
    "tensorflow": "a model of DeepRacer-for-Cloud or a console, with TensorFlow checkpoints",
    "upload": "the file of a policy, but not where a model has its checkpoints",
    "traces": "traces or metrics, but no checkpoint",
    "files": "files, but no checkpoint",
    "nothing": "nothing",
}


def what_helps(model: ModelStore, *, setting: str = "", variables: str = "") -> str:
    """For a command that misses a checkpoint or file: one that works.

    `variables` (each followed by a space) precede it if the bucket is not that of the settings.
    """
    kind = ModelListing(model).kind
    url = model.url
    if kind == "drcli":
        resume = f"{variables}dr-start-training --resume"
        return f"Restore it from a copy; `{resume}` reconstructs what it can."
    if kind in ("tensorflow", "upload"):
        command = f"{variables}{import_command(model, local=True)}"
        if kind == "tensorflow":
            return f"Restore it from a copy, or make a model of what is there with `{command}`."
        return f"{url} holds {KIND_WORDS[kind]}: make it a model with `{command}`."
    if kind == "traces":
        return f"{url} holds {KIND_WORDS[kind]}: `{variables}dr-analyze {model.prefix}` shows them."
    other = f"correct {setting or 'its name'}; `{variables}dr-list-models` lists all models."
    if kind == "files":
        return f"If it is being trained, wait for its first iteration; otherwise {other}"
    return f"There is nothing at {url}: train it with `{variables}dr-start-training`, or {other}"


def import_command(model: ModelStore, *, local: bool) -> str:
    """Makes a model of ours; unless `local`, from the bucket of uploads."""
    name = f"{model.prefix}-imported"
    if local:
        number = 1
        while is_used(ModelStore(model.bucket, name)):
            number += 1
            name = f"{model.prefix}-imported-{number}"
    return f"dr-import {'-L ' if local else ''}{model.url} -t {name}"
