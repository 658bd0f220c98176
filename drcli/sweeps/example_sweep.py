"""Writes the example of the file of a sweep."""

from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError
from drcli.config.example_files import model_file


def write_example(path: Path) -> Path:
    """Write the example, unless there is a file.

    Raises:
        SettingsError: There is a file, or it cannot be written.
    """
    if path.exists():
        raise SettingsError(
            f"{path} exists.", remedy="Name another file, as in `dr-sweep init second.yaml`."
        )
    if not path.parent.is_dir():
        raise SettingsError(f"{path.parent} is not a folder.", remedy="Create it first.")
    rewrite(path, model_file("sweep.yaml").read_bytes())
    return path
