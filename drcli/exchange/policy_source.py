"""What drives a racer of an evaluation, and which engine runs it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Runtime = Literal["torch", "pb", "onnx", "openvino", "tflite"]
"""PyTorch, our interpreter of frozen graphs, onnxruntime, OpenVINO, TensorFlow Lite."""


@dataclass(frozen=True)
class PolicySource:
    """A checkpoint of a model in the bucket, or a file on the machine that drives.

    Attributes:
        runtime: What runs it. A checkpoint is converted for it; None is PyTorch for a checkpoint
            and a file's own engine.
        file: Absolute path of a policy's file; None for a checkpoint.
        metadata: Absolute path of its model_metadata.json; None if that lies beside the file or
            inside of it.
        sha256: Of the file when it was checked, so that no other one drives; empty before.
    """

    runtime: Runtime | None = None
    file: Path | None = None
    metadata: Path | None = None
    sha256: str = ""
