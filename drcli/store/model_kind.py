"""What kind of model lies below a prefix, and which command works on it as it stands."""

import re
from collections.abc import Collection
from typing import Literal

from drcli.store import keys
from drcli.store.bucket import TEST_FOLDER, Bucket
from drcli.store.model_prefix import is_used

Kind = Literal["drcli", "tensorflow", "upload", "traces", "files", "nothing"]
"""A model of ours; one of DeepRacer-for-Cloud or a console, with TensorFlow checkpoints; a policy
that is not laid out as a model; traces or metrics without a checkpoint; other files, such as those
of a start that ended early; nothing."""

_OURS = re.compile(r"model/\d+_Step-\d+\.ckpt\.(safetensors|json)")
_TENSORFLOW = re.compile(r"model/\d+_Step-\d+\.ckpt\.(index|data-\d{5}-of-\d{5})")
_POLICY = re.compile(r"([^/]+/)?[^/]+\.(pb|onnx|ckpt\.index)")
_TRACES = re.compile(r"(.*/)?(training|evaluation)-simtrace/[^/]+\.csv|metrics/.+\.json")


def kind_of(names: Collection[str]) -> Kind:
    """The kind of a model that consists of these objects, by their keys below its prefix."""
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
    """Whether a checkpoint is the reference's alone, by the keys in the folder of checkpoints.

    The record of one of ours is written last, so weights without it do not count.
    """
    index = keys.checkpoint_part(prefix, name, ".index")
    return index in listed and keys.checkpoint_record(prefix, name) not in listed


def model_kind(bucket: Bucket, prefix: str) -> Kind:
    """The kind of model below a prefix.

    Raises:
        StorageError: The bucket does not answer, so the kind is unknown.
    """
    folder = keys.folder(prefix)
    test = folder + TEST_FOLDER
    listed = [info.key for info in bucket.list(folder)]
    return kind_of([key.removeprefix(folder) for key in listed if not key.startswith(test)])


KIND_WORDS: dict[Kind, str] = {
    "drcli": "a model of drcli",
    "tensorflow": "a model of DeepRacer-for-Cloud or a console, with TensorFlow checkpoints",
    "upload": "the file of a policy, but not where a model has its checkpoints",
    "traces": "traces or metrics, but no checkpoint",
    "files": "files, but no checkpoint",
    "nothing": "nothing",
}


def what_helps(bucket: Bucket, prefix: str, *, setting: str = "", variables: str = "") -> str:
    """The advice for a command that misses a checkpoint or a file of a model: one that works.

    Args:
        bucket: With the model.
        prefix: Of the model.
        setting: Names the model; empty for the prefix itself.
        variables: What a shell needs before a command, each with a space behind it, if the bucket
            is not that of the settings.
    """
    kind = model_kind(bucket, prefix)
    url = f"s3://{bucket.name}/{prefix}"
    if kind == "drcli":
        resume = f"{variables}dr-start-training --resume"
        return f"Restore it from a copy; `{resume}` reconstructs what it can."
    if kind in ("tensorflow", "upload"):
        command = f"{variables}{import_command(bucket, prefix, local=True)}"
        if kind == "tensorflow":
            return f"Restore it from a copy, or make a model of what is there with `{command}`."
        return f"{url} holds {KIND_WORDS[kind]}: make it a model with `{command}`."
    if kind == "traces":
        return f"{url} holds {KIND_WORDS[kind]}: `{variables}dr-analyze {prefix}` shows them."
    other = f"correct {setting or 'its name'}; `{variables}dr-list-models` lists all models."
    if kind == "files":
        return f"If it is being trained, wait for its first iteration; otherwise {other}"
    return f"There is nothing at {url}: train it with `{variables}dr-start-training`, or {other}"


def import_command(bucket: Bucket, prefix: str, *, local: bool) -> str:
    """The command that makes a model of ours from what lies below a prefix.

    Args:
        bucket: With the files.
        prefix: Of the files.
        local: Whether the bucket is that of the settings; else it is the one of uploads.
    """
    name = f"{prefix}-imported"
    if local:
        number = 1
        while is_used(bucket, name):
            number += 1
            name = f"{prefix}-imported-{number}"
    return f"dr-import {'-L ' if local else ''}s3://{bucket.name}/{prefix} -t {name}"
