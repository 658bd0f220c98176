"""What drives a racer of an evaluation, and which engine."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Runtime = Literal["torch", "pb", "onnx", "openvino", "tflite"]
"""PyTorch, our interpreter of frozen graphs, onnxruntime, OpenVINO, TensorFlow Lite."""


@dataclass(frozen=True)
class PolicySource:
    """A checkpoint of a model in the bucket, or a file here.

    Attributes:
        runtime: None: PyTorch, or a file's own engine.
        metadata: model_metadata.json; None if beside or inside the file.
        sha256: Of the checked file, so that no other drives.
    """

    runtime: Runtime | None = None
    file: Path | None = None
    metadata: Path | None = None
    sha256: str = ""
