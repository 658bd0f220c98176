"""A physical car's web server with its rules, over https with a certificate of its own making."""

import datetime
import hashlib
import io
import ipaddress
import json
import secrets
import tarfile
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import repeat
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from werkzeug import Request, Response
from werkzeug.serving import make_server

from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.model.files.model_metadata import ModelMetadata
from drcli.transfer.export_forms import Network
from small_policies import metadata_json, small_metadata, small_network

PASSWORD = "sticker"
SENSOR_NAMES = {
    "FRONT_FACING_CAMERA": "Single camera",
    "observation": "Single camera",
    "LEFT_CAMERA": "Single camera",
    "STEREO_CAMERAS": "Stereo camera",
    "LIDAR": "LiDAR",
    "SECTOR_LIDAR": "LiDAR",
}


@dataclass
class Installed:
    """A folder on the car; without metadata if the installation has not finished."""

    metadata: dict[str, Any] | None
    md5: str = ""


@dataclass
class FakeCar:
    """The state of a car, and switches for its failures.

    Attributes:
        community: Whether it runs the community's software.
        looks_left: Looks at the list before a slow installation is done.
        polls_left: Questions about the load before it is done.
        slow: Name of what was uploaded last, with its content.
        failures: Status by path; the path answers it that often (a list is used up).
        requests: Method and path of all requests but that for events.
        config: What its page keeps of its software's settings; None for software before 2.3.0.
        offers: Which of them it can have.
        status: What it measures of itself.
        picture: What its camera sends, JPEG; empty for none.
        events: What it tells while it drives: name and data.
    """

    community: bool = True
    config: dict[str, dict[str, Any]] | None = None
    offers: dict[str, Any] = field(default_factory=dict)
    status: dict[str, float] = field(
        default_factory=lambda: {"cpu_percent": 12.5, "fps_mean": 29.9}
    )
    picture: bytes = b""
    events: SimpleQueue[tuple[str, Any]] = field(default_factory=SimpleQueue)
    connected: set[str] = field(default_factory=lambda: {"Single camera"})
    models: dict[str, Installed] = field(default_factory=dict)
    looks_left: int = 0
    slow: dict[str, Installed] = field(default_factory=dict)
    polls_left: int = 0
    load_polls: int = 2
    load_ends: str = "loaded"
    state: str = "none"
    loaded: str = ""
    drive_mode: str = "manual"
    driving: bool = False
    throttle: float = 50
    tokens: set[str] = field(default_factory=set)
    csrf: dict[str, str] = field(default_factory=dict)
    failures: dict[str, list[int]] = field(default_factory=dict)
    refusals: dict[str, str] = field(default_factory=dict)
    forgets: bool = False
    requests: list[str] = field(default_factory=list)
    hook: Callable[[str], None] = lambda path: None

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Any:
        """Answer a request."""
        request = Request(environ)
        if request.path == "/api/events" and self.config is not None:
            told = Response(self._events(), content_type="text/event-stream")
            return told(environ, start_response)
        if request.path == "/api/events":
            return Response("<html>404</html>", 404)(environ, start_response)
        self.requests.append(f"{request.method} {request.path}")
        self.hook(request.path)
        return self._answer(request)(environ, start_response)

    def _answer(self, request: Request) -> Response:
        path = request.path
        if self.failures.get(path):
            return Response("<html>error</html>", self.failures[path].pop(0))
        if path == "/login" and request.method == "POST":
            return self._login(request) if self._has_token(request) else self._no_csrf()
        if path in ("/", "/login", "/home"):
            return self._page(request)
        if request.cookies.get("deepracer_token") not in self.tokens:
            return Response("<html>401 Authorization Required</html>", 401)
        if request.method != "GET" and not self._has_token(request):
            return self._no_csrf()
        if path in self.refusals:
            return _json({"success": False, "reason": self.refusals[path]})
        return self._api(request, path.split("/"))

    def _api(self, request: Request, parts: list[str]) -> Response:
        match [request.method, *parts[2:]]:
            case ["GET", "models"]:
                return self._list()
            case ["GET", "uploaded_model_list"]:
                return _json([{"name": name, "size": "12M"} for name in self.models])
            case ["POST" | "PUT", "uploadModels"]:
                return self._upload(request)
            case ["PUT" | "POST", "models", folder, file]:
                return self._load(folder, file)
            case ["GET", "isModelLoading"]:
                return _json({"success": True, "isModelLoading": self._loading()})
            case ["PUT" | "POST", "drive_mode"]:
                self.drive_mode = json.loads(request.get_data())["drive_mode"]
                return _json({"success": True})
            case ["PUT" | "POST", "start_stop"]:
                starts = json.loads(request.get_data())["start_stop"] == "start"
                self.driving = starts and self.drive_mode == "auto" and self.state == "loaded"
                return _json({"success": True})
            case ["PUT" | "POST", "max_nav_throttle"]:
                self.throttle = json.loads(request.get_data())["throttle"]
                return _json({"success": True})
            case ["GET", "car_config"] if self.config is not None:
                content = {"config": self.config, "capabilities": self.offers}
                return _json({"success": True, **content})
            case ["POST", "car_config"] if self.config is not None:
                return self._configure(json.loads(request.get_data()), self.config)
            case ["GET"] if request.path == "/route" and self.picture:
                kind = "multipart/x-mixed-replace;boundary=next"
                return Response(repeat(_part(self.picture)), content_type=kind)
            case ["GET", "supported_apis"] if self.community:
                return _json({"success": True, "apis_supported": ["/api/models"]})
            case ["GET", "get_device_status"] if self.community:
                return _json({"success": True, **self.status})
            case ["GET", "get_device_info"]:
                return _json({"success": True, "hardware_version": "R2.1", "software_version": "2"})
            case ["GET", "get_battery_level"]:
                return _json({"success": True, "battery_level": 9})
            case ["GET", "get_sensor_status"]:
                states = {"camera_status": "connected", "lidar_status": "not_connected"}
                return _json({"success": True, "stereo_status": "not_connected", **states})
            case _:
                return Response("<html>404</html>", 404)

    def _configure(self, wanted: dict[str, Any], kept: dict[str, dict[str, Any]]) -> Response:
        """Refuses what is not offered, ignores what is unknown, and derives what the IMU does."""
        if wanted.get("imu") and not self.offers.get("imu"):
            reason = "IMU configuration is not supported on this platform"
            return _json({"success": False, "reason": reason})
        if wanted.get("camera", {}).get("orientation", 0) not in (0, 180):
            return _json({"success": False, "reason": "camera.orientation must be 0 or 180"})
        for section, values in wanted.items():
            known = kept.get(section, {})
            known.update({key: value for key, value in values.items() if key in known})
        for kind in ("crash", "pickup"):
            threshold = kept["imu"][f"{kind}_threshold_g"]
            kept["imu"][f"{kind}_enabled"] = kept["imu"]["enabled"] and threshold != 0.0
        return _json({"success": True, "config": kept})

    def _events(self) -> Iterator[bytes]:
        """A real car says something every 15 s, and never ends."""
        yield b":\n\n"
        while self.driving:
            try:
                name, data = self.events.get(timeout=0.01)
            except Empty:
                yield b":\n\n"
            else:
                yield f"event: {name}\ndata: {json.dumps(data)}\n\n".encode()

    def _page(self, request: Request) -> Response:
        session = request.cookies.get("session") or secrets.token_hex(8)
        token = self.csrf.setdefault(session, secrets.token_hex(8))
        page = f'<html><head><meta name="csrf-token" content="{token}"></head></html>'
        answer = Response(page, content_type="text/html")
        answer.set_cookie("session", session, secure=True, httponly=True)
        return answer

    def _login(self, request: Request) -> Response:
        if request.form.get("password") != PASSWORD:
            return Response("failure")
        token = secrets.token_hex(16)
        if not self.community:
            self.tokens.clear()
        self.tokens.add(token)
        answer = _json({"redirect": "/home"})
        answer.set_cookie("deepracer_token", token, max_age=43_200, secure=True)
        return answer

    def _has_token(self, request: Request) -> bool:
        sent = request.headers.get("X-CSRFToken") or request.form.get("csrf_token")
        return bool(sent) and sent == self.csrf.get(request.cookies.get("session", ""))

    def _no_csrf(self) -> Response:
        return Response("<html>400 The CSRF token has expired.</html>", 400)

    def _list(self) -> Response:
        if self.slow:
            self.looks_left -= 1
            if self.looks_left < 0:
                self.models.update(self.slow)
                self.slow = {}
        entries = [
            {
                "model_name": "model",
                "model_folder_name": name,
                "model_training_algorithm": "PPO",
                "model_action_space_type": "Discrete",
                "model_sensors": (names := [SENSOR_NAMES[s] for s in _sensors(one.metadata)]),
                "is_select_disabled": not set(names) <= self.connected,
            }
            for name, one in self.models.items()
            if one.metadata is not None and set(_sensors(one.metadata)) <= set(SENSOR_NAMES)
        ]
        entries.sort(key=lambda entry: bool(entry["is_select_disabled"]))
        kinds = {"camera": "Single camera", "stereo": "Stereo camera", "lidar": "LiDAR"}
        states = {
            f"{kind}_status": "connected" if name in self.connected else "not_connected"
            for kind, name in kinds.items()
        }
        return _json({"models": entries, "sensor_status": states})

    def _upload(self, request: Request) -> Response:
        with closing(request.files["file"]) as file:
            content = file.read()
        if not str(file.filename).endswith(".tar.gz"):
            return _json({"success": False, "message": "Not a .tar.gz file"})
        name = str(file.filename)[:-7]
        self.models[name] = Installed(None)
        if self.forgets:
            return _json({"success": True, "message": "uploaded"})
        found = self._unpacked(content)
        if found is None:
            return _json({"success": False, "message": "Failed to upload & optimize the model"})
        if self.looks_left:
            self.slow = {name: found}
            return _json({"success": False, "message": "Failed to upload & optimize the model"})
        self.models[name] = found
        return _json({"success": True, "message": "Model uploaded successfully to your vehicle"})

    def _unpacked(self, content: bytes) -> Installed | None:
        """What the car finds in an archive; None if it refuses it."""
        with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as archive:
            files = {m.name: archive.extractfile(m).read() for m in archive if m.isfile()}
        models = [name for name in files if Path(name).suffix in ".pb"]
        md5 = hashlib.md5(files[models[0]]).hexdigest() if models else ""
        if len(models) != 1 or md5 in {one.md5 for one in self.models.values()}:
            return None
        return Installed(json.loads(files["model_metadata.json"]), md5)

    def _load(self, folder: str, file: str) -> Response:
        if folder not in self.models or file != "model":
            return _json({"success": False, "reason": "Model optimization failed!"})
        self.state, self.loaded, self.polls_left = "loading", folder, self.load_polls
        return _json({"success": True})

    def _loading(self) -> str:
        if self.state == "loading":
            self.polls_left -= 1
            if self.polls_left < 0:
                self.state = self.load_ends
        return self.state


def _sensors(metadata: dict[str, Any] | None) -> list[str]:
    return list((metadata or {}).get("sensor", ["observation"]))


def _part(jpeg: bytes) -> bytes:
    head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
    return head.encode() + jpeg + b"\r\n"


def software_of_2026(*, imu: bool = True) -> dict[str, Any]:
    """What cars with 2.3.0 of the community's software keep and offer: `config` and `offers`."""
    config = {
        "logging": {"mode": "always", "provider": "sqlite3"},
        "camera": {"mode": "auto", "orientation": 0, "enable_gray_overlay": False},
        "inference": {"engine": "auto", "device": "auto"},
        "steering": {"mode": "servo"},
        "imu": {
            "enabled": False,
            "crash_threshold_g": 0.0,
            "crash_enabled": False,
            "pickup_threshold_g": 0.0,
            "pickup_enabled": False,
        },
    }
    offers = {
        "camera_modes": ["legacy", "modern"],
        "camera_orientations": [0, 180],
        "logging_modes": ["Never", "USBOnly", "Always"],
        "logging_providers": ["sqlite3", "mcap"],
        "inference_engines": ["TFLITE", "OV"],
        "inference_devices": {"TFLITE": ["CPU"], "OV": ["CPU"]},
        "steering_modes": ["servo"] if imu else ["servo", "diffdrive"],
        "gray_overlay": True,
        "imu": imu,
        "imu_crash_thresholds": [0.0, 1.5, 2.0, 2.5, 3.0] if imu else [],
        "imu_pickup_thresholds": [0.0, 0.5, 0.75, 0.95] if imu else [],
    }
    return {"config": config, "offers": offers}


def _json(content: Any) -> Response:
    return Response(json.dumps(content), content_type="application/json")


def make_certificate(folder: Path, name: str = "car") -> tuple[Path, Path]:
    """A certificate that signs itself, for localhost, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.UTC)
    names: list[x509.GeneralName] = [x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    files = folder / f"{name}.pem", folder / f"{name}.key"
    files[0].write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    form = serialization.PrivateFormat.PKCS8
    plain = serialization.NoEncryption()
    files[1].write_bytes(key.private_bytes(serialization.Encoding.PEM, form, plain))
    return files


@contextmanager
def served(
    car: Callable[..., Any], certificate: tuple[Path, Path] | None, port: int = 0
) -> Iterator[int]:
    """Serve a car on localhost, and give the port."""
    context = None if certificate is None else (str(certificate[0]), str(certificate[1]))
    server = make_server("127.0.0.1", port, car, threaded=True, ssl_context=context)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def archive(path: Path, **changes: Any) -> Path:
    """Write a file for the car: a model and its metadata; `files` replaces or removes members."""
    metadata = metadata_json(**changes.get("metadata", {}))
    files: dict[str, bytes | None] = {"model_metadata.json": metadata, **changes.get("files", {})}
    if "agent/model.pb" not in files:
        files["agent/model.pb"] = graph(path.name, changes.get("metadata", {}).get("sensor"))
    with tarfile.open(path, "w:gz") as out:
        for name, content in files.items():
            if content is not None:
                info = tarfile.TarInfo(name)
                info.size = len(content)
                out.addfile(info, io.BytesIO(content))
    return path


@cache
def _network(sensors: tuple[str, ...]) -> tuple[Network, ModelMetadata]:
    metadata = small_metadata(sensor=list(sensors))
    return small_network(metadata), metadata


def graph(name: str, sensors: list[str] | None = None) -> bytes:
    """A graph that is different for each name."""
    network, metadata = _network(tuple(sensors or ["FRONT_FACING_CAMERA"]))
    weights = weights_of(network)
    bias = next(key for key in weights if key.endswith("policy_head.bias"))
    weights[bias] = weights[bias] + zlib.crc32(name.encode()) % 1000
    return encode_policy(weights, network.spec, metadata.sensor)
