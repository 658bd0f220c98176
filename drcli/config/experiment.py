"""Which run.env counts: that of an experiment, of an activated shell, or the folder's own."""

from collections.abc import Mapping, Sequence

from drcli.base.problems import ProblemsError, one_of, shown
from drcli.config import activation
from drcli.config.env_file import Entry
from drcli.config.files import Files
from drcli.config.layers import Layers
from drcli.config.setting_problems import setting_problem
from drcli.config.value_types import FOLDER_NAME

EXPERIMENT = activation.EXPERIMENT


def chosen_experiment(files: Files, layers: Sequence[Mapping[str, Entry]]) -> str:
    """Name of the experiment, empty without one.

    Args:
        files: Of the working folder.
        layers: Entries by name, strongest layer first; run.env comes too late to choose itself.

    Raises:
        ProblemsError: There is no such experiment, or a file before it is wrong.
    """
    found = Layers(layers, {})
    name, entry = (found.text(EXPERIMENT) or "").strip(), found.find(EXPERIMENT)
    existing = files.experiments()
    if not name or entry is None or name in existing:
        return name
    written = f"{EXPERIMENT}={shown(name)}"
    if FOLDER_NAME.fullmatch(name):
        what = f"{written} has no experiments/{name}/run.env in {files.directory}."
        new = f"Write it with `dr init --experiment {name}`"
    else:
        what, new = f"{written} is not a plain folder name.", "Name a folder in experiments/"
    remedy = one_of(existing, name) if existing else f"{new}, or drop the name."
    problem = setting_problem(EXPERIMENT, entry.place, what, remedy)
    raise ProblemsError([*files.problems, problem])


def run_file(files: Files, layers: Sequence[Mapping[str, Entry]], experiment: str) -> str:
    """Path of the run.env, below the folder or absolute.

    Args:
        files: Of the working folder.
        layers: Entries by name, of flags and environment.
        experiment: Name of the experiment, empty without one.
    """
    if experiment:
        return f"experiments/{experiment}/run.env"
    outside = {name: entry.value for layer in layers for name, entry in layer.items()}
    return activation.run_file(outside, files.directory)
