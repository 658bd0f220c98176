"""Loads system.env and run.env into typed, frozen settings.

Settings win in this order: flag, process environment, run.env, system.env, default. A load reports
everything that is wrong at once.
"""

import os
from collections.abc import Mapping
from pathlib import Path

from drcli.base.problems import Place
from drcli.config import activation
from drcli.config.env_file import Entry
from drcli.config.loading import Loader
from drcli.config.model import Settings, catalogue
from drcli.config.secrets import hidden

__all__ = ["Settings", "active_run_file", "catalogue", "hidden", "load_settings"]


def load_settings(
    directory: Path,
    *,
    flags: Mapping[str, str] | None = None,
    environ: Mapping[str, str] | None = None,
    experiment: str | None = None,
    contents: Mapping[str, bytes] | None = None,
) -> Settings:
    """Read and check all settings.

    Args:
        directory: Folder with run.env and, usually, system.env.
        flags: Values from the command line, by DR_ name.
        environ: Process environment; `os.environ` when None.
        experiment: Use experiments/<name>/run.env instead of run.env.
        contents: Content of files, by names such as `run.env`, to be taken for what lies there.

    Raises:
        ProblemsError: Something is wrong, or there is no run.env.
    """
    given = dict(flags or {})
    if experiment:
        given["DR_EXPERIMENT_NAME"] = experiment
    return Loader(directory.absolute(), contents or {}).load(_upper(given, environ))


def active_run_file(
    directory: Path,
    *,
    flags: Mapping[str, str] | None = None,
    environ: Mapping[str, str] | None = None,
) -> str:
    """Which run.env counts: that of the experiment, where there is one.

    Args:
        directory: Folder with run.env.
        flags: Values from the command line, by DR_ name.
        environ: Process environment; `os.environ` when None.

    Raises:
        SettingsError: There is no such experiment, or system.env cannot be read.
    """
    return Loader(directory.absolute(), {}).run_file(_upper(flags or {}, environ))


def _upper(flags: Mapping[str, str], environ: Mapping[str, str] | None) -> list[dict[str, Entry]]:
    """The layers above the files, the strongest first."""
    return [
        _written(flags, "flag"),
        _written(activation.chosen(os.environ if environ is None else environ), "environment"),
    ]


def _written(values: Mapping[str, str], where: str) -> dict[str, Entry]:
    return {name: Entry(name, value, Place(where), expands=False) for name, value in values.items()}
