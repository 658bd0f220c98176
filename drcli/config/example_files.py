"""The example files for new working folders, installed or in a checkout."""

from importlib import resources
from pathlib import Path

READY_MADE = ("safe", "fast", "car")


def settings_file(name: str) -> Path:
    return _found(name, ".")


def model_file(name: str) -> Path:
    return _found(name, "defaults")


def presets_folder() -> Path:
    return _found("presets", "defaults")


def ready_made() -> tuple[str, ...]:
    """Names of the ready-made models that are shipped."""
    return tuple(name for name in READY_MADE if model_file(f"models/{name}/card.json").is_file())


def activate_script() -> Path:
    return _found("activate.sh", "scripts")


def _found(name: str, folder_in_checkout: str) -> Path:
    package = Path(str(resources.files("drcli")))
    installed = package / "_defaults" / name
    return installed if installed.exists() else package.parent / folder_in_checkout / name
