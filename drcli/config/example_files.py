"""The example files for new working folders, in the installed package or in a checkout."""

from importlib import resources
from pathlib import Path

READY_MADE = ("safe", "fast", "car")
"""Names of the models that `scripts/models` can make."""


def settings_file(name: str) -> Path:
    """The commented example of run.env or system.env."""
    return _found(name, ".")


def model_file(name: str) -> Path:
    """One of the three files of a model: an example, as `rewards/speed/reward_function.py`."""
    return _found(name, "defaults")


def presets_folder() -> Path:
    """The folder with a folder for each preset."""
    return _found("presets", "defaults")


def ready_made() -> tuple[str, ...]:
    """Names of the ready-made models that are shipped: those whose card was written."""
    return tuple(name for name in READY_MADE if model_file(f"models/{name}/card.json").is_file())


def activate_script() -> Path:
    """The script that every bin/activate.sh sources."""
    return _found("activate.sh", "scripts")


def _found(name: str, folder_in_checkout: str) -> Path:
    package = Path(str(resources.files("drcli")))
    installed = package / "_defaults" / name
    return installed if installed.exists() else package.parent / folder_in_checkout / name
