"""`dr version`."""

import platform
from dataclasses import asdict, dataclass

from drcli import __version__
from drcli.cli import terminal
from drcli.model.run_metadata import installed_versions


@dataclass(frozen=True)
class Versions:
    """What a training depends on.

    Attributes:
        version: The version of drcli, as `dr --version` prints it.
        python: The version of Python.
        torch: The version of PyTorch; null if it is not installed.
        mujoco: The version of MuJoCo; null if it is not installed.
        platform: Operating system, its version and the processor.
    """

    version: str
    python: str
    torch: str | None
    mujoco: str | None
    platform: str


def version() -> None:
    """Show the versions of drcli, Python, torch and MuJoCo, and the platform.

    Example: dr version --json
    """
    libraries = installed_versions(["torch", "mujoco"])
    report = Versions(
        __version__, platform.python_version(), **libraries, platform=platform.platform()
    )
    rows = {"drcli" if key == "version" else key: value for key, value in asdict(report).items()}
    lines = [f"{name:9} {value or 'not installed'}" for name, value in rows.items()]
    terminal.emit(report, "\n".join(lines))
