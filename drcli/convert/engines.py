"""The engines that run a policy's graph."""

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import DrError, SettingsError
from drcli.base.installation import is_installed, library, openvino_core, require
from drcli.convert.onnx_graph import PIXEL_RANGE, encode_onnx
from drcli.convert.onnx_reader import parse_onnx, read_onnx
from drcli.convert.policy_file import Form
from drcli.convert.tensorflow.graph import decode_graph
from drcli.convert.tensorflow.interpreter import Graph
from drcli.records.evaluation_task import Runtime

# Converts frozen graphs with other libraries.


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


Array = NDArray[Any]

RUNS: Mapping[Form, tuple[Runtime, ...]] = {
    "pb": ("pb", "onnx", "openvino", "tflite"),
    "onnx": ("onnx", "openvino", "pb"),
    "openvino": ("openvino",),
    "tflite": ("tflite", "openvino"),
}
"""The first is the default."""

SCALES = {"NominalRange_0_255": 1.0, "Normalized_0_1": 1.0 / 255.0}
"""For ranges of pixels that an ONNX file may state."""


@dataclass(frozen=True)
class Port:
    """`shape` has -1 for a length that is not fixed, and is None if unknown."""

    name: str
    shape: tuple[int, ...] | None
    dtype: np.dtype[Any]


class Engine(Protocol):
    """A graph that is ready to run; pixels from 0 to 255 are multiplied by `pixel_scale`."""

    name: str
    pixel_scale: float

    @property
    def inputs(self) -> Sequence[Port]:
        """What it takes."""

    def run(self, feeds: Mapping[str, Array]) -> dict[str, Array]:
        """Outputs in the file's order, from equally many rows."""


def check_runtime(form: Form, runtime: Runtime, origin: str) -> None:
    """Check an engine without loading it.

    Raises:
        SettingsError: It does not run such files.
        NotAvailable: It is not installed.
    """
    if runtime not in RUNS[form]:
        listed = " or ".join(RUNS[form])
        raise SettingsError(
            f"--runtime {runtime} does not run {origin}.",
            remedy=f"Use --runtime {listed}, or import the model with `dr-import` to train it."
            if runtime == "torch"
            else f"Use --runtime {listed}.",
        )
    if "onnx" in (runtime, form):
        require("onnx")
    if runtime == "onnx":
        require("onnxruntime")
    if runtime == "openvino":
        require("openvino")
    if runtime == "tflite":
        require("ai_edge_litert", "tensorflow")
        if form == "pb":
            require("tensorflow")


def check_converter(form: Form) -> None:
    """NotAvailable if a form cannot be written or run; loads nothing."""
    runtime = RUNS[form][0]
    if runtime == "tflite":
        require("tensorflow")
    check_runtime(form, runtime, f"a file of the form {form}")


def open_engine(
    form: Form, data: bytes, weights: bytes, runtime: Runtime, origin: str, threads: int = 1
) -> Engine:
    """Load a graph, converted if needed; `weights`: the second file of OpenVINO's pair.

    Raises:
        SettingsError: The engine does not run it, or it is damaged.
        NotAvailable: The engine is not installed.
    """
    check_runtime(form, runtime, origin)
    if runtime == "pb":
        nodes = decode_graph(data, origin) if form == "pb" else read_onnx(data, origin)
        return _Interpreter(Graph(nodes, origin))
    if form == "pb" and runtime in ("onnx", "tflite"):
        nodes = decode_graph(data, origin)
        Graph(nodes, origin)
        data = encode_onnx(nodes, origin) if runtime == "onnx" else tflite_of(data, origin)
    scale = _pixel_scale(data, origin) if form == "onnx" else 1.0
    try:
        if runtime == "onnx":
            return _OnnxRuntime(data, threads, scale)
        if runtime == "openvino":
            return _OpenVino(form, data, weights, threads, scale)
        return _TensorFlowLite(data, threads)
    except (DrError, MemoryError):
        raise
    except Exception as error:  # engines raise whatever their C++ code does
        cannot_load(origin, _NAMES[runtime], error)


def cannot_load(origin: str, engine: str, error: Exception) -> NoReturn:
    raise SettingsError(
        f"{origin} cannot be loaded by {engine}: {reason_of(error)}",
        remedy="Write the file again, or name another one.",
    ) from None


def reason_of(error: Exception) -> str:
    """The line that says most; engines put places in their code first."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    told = [line for line in lines if ".cpp:" not in line and not line.startswith("Exception from")]
    text = (told or lines or [type(error).__name__])[0]
    return text[:300].rstrip(".") + "."


_NAMES: Mapping[Runtime, str] = {
    "torch": "PyTorch",
    "pb": "drcli's interpreter",
    "onnx": "onnxruntime",
    "openvino": "OpenVINO",
    "tflite": "TensorFlow Lite",
}


class _Interpreter:
    name = _NAMES["pb"]
    pixel_scale = 1.0

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        float32 = np.dtype(np.float32)
        self.inputs = [Port(name, shape, float32) for name, shape in graph.inputs.items()]

    def run(self, feeds: Mapping[str, Array]) -> dict[str, Array]:
        return {self._graph.output.name: self._graph.run(feeds)}


_ONNX_DTYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}


class _OnnxRuntime:
    name = _NAMES["onnx"]

    def __init__(self, data: bytes, threads: int, pixel_scale: float) -> None:
        runtime = library("onnxruntime")
        options = runtime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
        # A thread that spins while it waits takes the core from the simulation.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 4
        self._session = runtime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        self.pixel_scale = pixel_scale
        self.inputs = [
            Port(
                value.name,
                tuple(d if isinstance(d, int) and d > 0 else -1 for d in value.shape),
                np.dtype(_ONNX_DTYPES.get(value.type, object)),
            )
            for value in self._session.get_inputs()
        ]
        self._outputs = [value.name for value in self._session.get_outputs()]

    def run(self, feeds: Mapping[str, Array]) -> dict[str, Array]:
        results = self._session.run(None, dict(feeds))
        return dict(zip(self._outputs, results, strict=True))


class _OpenVino:
    name = _NAMES["openvino"]

    def __init__(
        self, form: Form, data: bytes, weights: bytes, threads: int, pixel_scale: float
    ) -> None:
        core = openvino_core()
        if form == "openvino":
            model = core.read_model(data, weights)
        else:  # it recognises other forms by the names of files
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"model.{form}"
                path.write_bytes(data)
                model = core.read_model(path)
        # Without this, processors with bfloat16 would round to three digits.
        hints = {"INFERENCE_PRECISION_HINT": "f32", "INFERENCE_NUM_THREADS": threads}
        self._model = core.compile_model(model, "CPU", hints)
        self.pixel_scale = pixel_scale
        self.inputs = [
            Port(
                _name(port, number),
                tuple(d.get_length() if d.is_static else -1 for d in port.partial_shape)
                if port.partial_shape.rank.is_static
                else None,
                np.dtype(port.element_type.to_dtype()),
            )
            for number, port in enumerate(self._model.inputs)
        ]

    def run(self, feeds: Mapping[str, Array]) -> dict[str, Array]:
        results = self._model([feeds[port.name] for port in self.inputs])
        return {
            _name(port, number): np.array(results[port])
            for number, port in enumerate(self._model.outputs)
        }


def _name(port: Any, number: int) -> str:
    return min(port.get_names(), default=f"{number}")


class _TensorFlowLite:
    name = _NAMES["tflite"]
    pixel_scale = 1.0

    def __init__(self, data: bytes, threads: int) -> None:
        if is_installed("ai_edge_litert"):
            module = library("ai_edge_litert.interpreter")
        else:
            module = library("tensorflow").lite
        self._lite = module.Interpreter(model_content=data, num_threads=threads)
        self._lite.allocate_tensors()
        self._details = {d["name"]: d for d in self._lite.get_input_details()}
        self._rows = 1
        self.inputs = []
        for name, detail in self._details.items():
            shape = tuple(int(d) for d in detail.get("shape_signature", detail["shape"]))
            quantized = bool(detail["quantization"][0])
            dtype = np.dtype(np.float32 if quantized else detail["dtype"])
            self.inputs.append(Port(name, shape, dtype))

    def run(self, feeds: Mapping[str, Array]) -> dict[str, Array]:
        rows = len(next(iter(feeds.values())))
        if rows != self._rows:
            for name, values in feeds.items():
                self._lite.resize_tensor_input(self._details[name]["index"], values.shape)
            self._lite.allocate_tensors()
            self._rows = rows
        for name, values in feeds.items():
            self._lite.set_tensor(
                self._details[name]["index"], _quantized(self._details[name], values)
            )
        self._lite.invoke()
        return {
            detail["name"]: _unquantized(detail, self._lite.get_tensor(detail["index"]))
            for detail in self._lite.get_output_details()
        }


def _quantized(detail: Mapping[str, Any], values: Array) -> Array:
    step, zero = detail["quantization"]
    if not step:
        return values
    limits = np.iinfo(detail["dtype"])
    whole = np.rint(values / step) + zero
    clipped: Array = np.clip(whole, limits.min, limits.max).astype(detail["dtype"])
    return clipped


def _unquantized(detail: Mapping[str, Any], values: Array) -> Array:
    step, zero = detail["quantization"]
    return (values.astype(np.float32) - zero) * step if step else values


def _pixel_scale(data: bytes, origin: str) -> float:
    model = parse_onnx(data, origin)
    stated = {item.key: item.value for item in model.metadata_props}.get(PIXEL_RANGE)
    if stated is None:
        return 1.0
    if stated not in SCALES:
        raise SettingsError(
            f"{origin} wants pixels in the range {PIXEL_RANGE}={stated:.80}, which is not known.",
            remedy=f"Write one of {', '.join(SCALES)} there.",
        )
    return SCALES[stated]
