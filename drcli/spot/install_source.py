"""Where a machine installs drcli from."""

import hashlib
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import drcli
from drcli.base.errors import SettingsError

PACKAGES = ("python3-venv", "ca-certificates")
_BUILD_PATIENCE_S = 300.0


@dataclass(frozen=True)
class InstallSource:
    """What pip gets: a requirement, or a wheel."""

    requirement: str
    wheel: str = ""
    data: bytes = b""
    packages: tuple[str, ...] = PACKAGES

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest() if self.wheel else ""

    @property
    def shown(self) -> str:
        return self.wheel or self.requirement


def find_source(wanted: str) -> InstallSource:
    """A wheel, URL or requirement; empty means the running drcli.

    Raises:
        SettingsError: The wheel is missing or cannot be built.
    """
    if not wanted:
        checkout = Path(drcli.__file__).resolve().parents[1]
        if (checkout / "pyproject.toml").is_file():
            return _built(checkout)
        return InstallSource(f"drcli=={drcli.__version__}")
    if wanted.endswith(".whl"):
        return _read(Path(wanted))
    if wanted.startswith("git+"):
        return InstallSource(wanted, packages=(*PACKAGES, "git"))
    if wanted.startswith("-") or any(letter.isspace() for letter in wanted):
        raise SettingsError(
            f"'{wanted[:80]}' is not something that pip can install (--install).",
            remedy="Name a .whl file, git+https://..., or a requirement such as drcli==1.2.",
        )
    return InstallSource(wanted)


def torch_requirement() -> str:
    try:
        needed = requires("drcli") or []
    except PackageNotFoundError:
        needed = []
    exact = (line.partition(";")[0].strip() for line in needed)
    return next((line for line in exact if line.startswith("torch==")), "torch")


def _read(path: Path) -> InstallSource:
    try:
        return InstallSource("", path.name, path.read_bytes())
    except OSError as error:
        raise SettingsError(
            f"{path}: cannot be read ({error.strerror or error}) (--install).",
            remedy="Name a wheel that exists.",
        ) from error


def _built(checkout: Path) -> InstallSource:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir"]
        tries = (
            [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder],
            [*command, folder],
        )
        said = ""
        for each in tries:
            try:
                done = subprocess.run(
                    [*each, str(checkout)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    timeout=_BUILD_PATIENCE_S,
                    check=False,
                )
            except (OSError, subprocess.TimeoutExpired) as error:
                said = str(error)
                continue
            wheels = sorted(Path(folder).glob("*.whl"))
            if done.returncode == 0 and wheels:
                return _read(wheels[0])
            lines = done.stdout.decode(errors="replace").strip().splitlines()
            said = lines[-1] if lines else f"code {done.returncode}"
    raise SettingsError(
        f"No wheel can be made of {checkout}: {said}.",
        remedy="Install the tools with `pip install build hatchling`, or name a wheel, an address "
        "or a version with --install.",
    )
