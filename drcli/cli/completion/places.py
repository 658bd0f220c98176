"""Which values belong to which option or argument of which command."""

from collections.abc import Iterator, Mapping
from typing import Any

from drcli.cli.completion import values
from drcli.cli.completion.scripts import SHELLS
from drcli.cli.completion.values import Place, Values


def _shells(place: Place) -> Iterator[str]:
    yield from SHELLS


def _settings_files(place: Place) -> Iterator[str]:
    yield from ("run.env", "system.env")


VALUES: Mapping[tuple[str, str], Values] = {
    ("increment-training", "prefix"): values.model_prefixes,
    ("upload-model", "prefix"): values.model_prefixes,
    ("upload-model", "number"): values.checkpoints,
    ("download-model", "target"): values.model_prefixes,
    ("list-models", "pattern"): values.model_prefixes,
    ("logs", "worker"): values.workers,
    ("init", "world"): values.worlds,
    ("init", "race_type"): values.race_types,
    ("init", "cloud"): values.clouds,
    ("init", "experiment"): values.experiments,
    ("config show", "names"): values.setting_names,
    ("config set", "values"): values.assignments,
    ("config set", "file"): _settings_files,
    ("completion show", "shell"): _shells,
    ("completion install", "shell"): _shells,
    ("tracks show", "name"): values.worlds,
    ("reward check", "world"): values.worlds,
    ("reward plot", "world"): values.worlds,
    ("reward compare", "world"): values.worlds,
}
"""By command and name of the parameter in its function."""


def values_of(path: str, parameter: Any, place: Place) -> Iterator[str]:
    """What a parameter may be; nothing where it may be anything.

    Args:
        path: The command, as `tracks show`.
        parameter: As Typer describes it.
        place: Where the Tab key was pressed.
    """
    known = VALUES.get((path, parameter.name))
    if known is not None:
        yield from known(place)
        return
    for choice in getattr(parameter.type_descriptor, "choices", None) or ():
        yield str(getattr(choice, "value", choice))
