"""Writes an example sweep file."""

from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError
from drcli.base.replaceable import refuse_existing
from drcli.config.example_files import model_file


def write_example(path: Path, *, force: bool = False) -> Path:
    """Raises SettingsError for an existing file without `force`, or an unwritable one."""
    refuse_existing(path, force=force)
    if not path.parent.is_dir():
        raise SettingsError(f"{path.parent} is not a folder.", remedy="Create it first.")
    rewrite(path, model_file("sweep.yaml").read_bytes())
    return path
