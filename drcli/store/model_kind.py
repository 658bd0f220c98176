"""What lies below a prefix, and which command works on it."""

import re
from collections.abc import Collection
from typing import Literal

from drcli.store import keys
from drcli.store.bucket import TEST_FOLDER, Bucket
from drcli.store.model_prefix import is_used

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


def model_kind(bucket: Bucket, prefix: str) -> Kind:
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
    """For a command that misses a checkpoint or file: one that works.

    `variables` (each followed by a space) precede it if the bucket is not that of the settings.
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
    """Makes a model of ours; unless `local`, from the bucket of uploads."""
    name = f"{prefix}-imported"
    if local:
        number = 1
        while is_used(bucket, name):
            number += 1
            name = f"{prefix}-imported-{number}"
    return f"dr-import {'-L ' if local else ''}s3://{bucket.name}/{prefix} -t {name}"
