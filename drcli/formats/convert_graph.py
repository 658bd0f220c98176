"""Converts frozen graphs with other libraries."""

import os
import tempfile
from pathlib import Path
from typing import Any

from drcli.base.errors import SettingsError
from drcli.formats.extras import library, openvino_core
from drcli.formats.tensorflow.graph import decode_graph
from drcli.formats.tensorflow.interpreter import Graph

_REMEDY = "Export the model in another form."


def openvino_of(data: bytes, origin: str, *, fp16: bool = False) -> tuple[bytes, bytes]:
    """OpenVINO's `.xml` and `.bin` of a frozen graph; `fp16`: of its weights.

    `openvino.convert_model` would report its use to its makers.

    Raises:
        NotAvailable: `openvino` is missing.
        SettingsError: It does not convert the graph.
    """
    openvino, core = library("openvino"), openvino_core()
    with tempfile.TemporaryDirectory() as folder:
        graph, xml = Path(folder, "model.pb"), Path(folder, "model.xml")
        graph.write_bytes(data)
        try:
            model = core.read_model(graph)
            openvino.save_model(model, xml, compress_to_fp16=fp16)
        except Exception as error:  # it raises whatever its C++ code does
            raise _unconverted(origin, "OpenVINO", error) from None
        return xml.read_bytes(), xml.with_suffix(".bin").read_bytes()


def tflite_of(data: bytes, origin: str) -> bytes:
    """The TensorFlow Lite file of a frozen graph, as of the car's optimizer.

    Weights in half precision, built-in operations only.

    Raises:
        NotAvailable: TensorFlow is missing.
        SettingsError: It does not convert the graph.
    """
    graph = Graph(decode_graph(data, origin), origin)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    tensorflow = library("tensorflow")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.pb")
        path.write_bytes(data)
        try:
            converted: bytes = _tflite(tensorflow, graph, path)
        except Exception as error:  # its converter raises many kinds
            raise _unconverted(origin, "TensorFlow", error) from None
        return converted


def _tflite(tensorflow: Any, graph: Graph, path: Path) -> Any:
    lite = tensorflow.compat.v1.lite.TFLiteConverter
    shapes = {name: [1, *shape[1:]] for name, shape in graph.inputs.items()}
    converter = lite.from_frozen_graph(str(path), list(graph.inputs), [graph.output.name], shapes)
    converter.optimizations = [tensorflow.lite.Optimize.DEFAULT]
    converter.target_spec.supported_types = [tensorflow.float16]
    converter.target_spec.supported_ops = [tensorflow.lite.OpsSet.TFLITE_BUILTINS]
    return converter.convert()


def _unconverted(origin: str, library_name: str, error: Exception) -> SettingsError:
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:300]
    return SettingsError(
        f"{origin} cannot be converted by {library_name}: {reason.rstrip('.')}.", remedy=_REMEDY
    )
