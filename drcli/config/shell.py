"""The settings of a working folder as variables of a shell: what to export, what to take away."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.base.problems import Place, ProblemsError
from drcli.config import activation
from drcli.config.env_file import Entry
from drcli.config.experiment import EXPERIMENT, chosen_experiment, run_file
from drcli.config.files import Files
from drcli.config.layers import Layers

OURS = (activation.FOLDER, activation.RUN_FILE, activation.MARK)
"""Variables that activation sets by itself, whatever a file says."""


@dataclass(frozen=True)
class ShellChange:
    """What activation changes in a shell.

    Attributes:
        export: Variables to set, by name.
        unset: Variables that an earlier activation left and that stand in no file any more.
        warnings: Sentences about values that could not be filled in.
    """

    export: Mapping[str, str]
    unset: tuple[str, ...]
    warnings: tuple[str, ...]

    def script(self) -> str:
        """Lines for bash and zsh that make the change."""
        lines = [f"unset {name}\n" for name in self.unset]
        lines += [f"export {name}={shlex.quote(value)}\n" for name, value in self.export.items()]
        return "".join(lines)


def shell_change(
    directory: Path,
    environ: Mapping[str, str],
    *,
    experiment: str = "",
) -> ShellChange:
    """What the files of a working folder mean for a shell.

    Values are taken as they are written: whether a setting makes sense is for the commands to say.

    Args:
        directory: Folder with run.env, absolute.
        environ: The shell's environment. What somebody exported there by hand wins over the files.
        experiment: Take experiments/<name>/run.env from now on; empty leaves it as it is.

    Raises:
        SettingsError: A file is missing, or a line of it cannot be read.
    """
    given = activation.chosen(environ)
    outside = {
        key: Entry(key, value, Place("environment"), expands=False) for key, value in given.items()
    }
    if experiment:
        outside[EXPERIMENT] = Entry(EXPERIMENT, experiment, Place("-e"), expands=False)
    files = Files(directory, {})
    system = files.read("system.env") if files.exist("system.env") else {}
    name = run_file(files, [outside], chosen_experiment(files, [outside, system]))
    run = files.read(name)
    if any(problem.severity == "error" for problem in files.problems):
        raise ProblemsError(files.problems)

    layers = Layers([outside, run, system], {})
    names = [key for key in {**system, **run} if key not in outside and key not in OURS]
    texts = {key: layers.text(key) or "" for key in names}
    if layers.problems:
        layers = Layers([outside, run, system], _defaults())
        texts = {key: layers.text(key) or "" for key in names}
    copies = {**_derived({**given, **texts}, directory), **texts}
    export = {
        activation.FOLDER: str(directory),
        activation.RUN_FILE: str(directory / name),
        **({EXPERIMENT: experiment} if experiment else {}),
        **copies,
        activation.MARK: activation.marked(copies),
    }
    gone = activation.copies(environ) - export.keys()
    warnings = tuple(str(problem) for problem in layers.problems.values())
    return ShellChange(export, tuple(sorted(gone)), warnings)


def _defaults() -> dict[str, str]:
    """Defaults of all settings, for values that refer to one; loading them takes a while."""
    from drcli.config.settings import catalogue

    return {name: setting.default_text for name, setting in catalogue().items()}


def _derived(values: Mapping[str, str], directory: Path) -> dict[str, str]:
    """What the reference's activation works out besides, as far as it means something here."""
    derived = {"DR_RUN_ID": "0"} if "DR_RUN_ID" not in values else {}
    if region := values.get("DR_AWS_APP_REGION"):
        derived["AWS_DEFAULT_REGION"] = region
    address = _address(values, directory)
    if address:
        profile = values.get("DR_LOCAL_S3_PROFILE")
        derived["DR_LOCAL_S3_ENDPOINT_URL"] = derived["DR_MINIO_URL"] = address
        derived["DR_LOCAL_PROFILE_ENDPOINT_URL"] = " ".join(
            [*(["--profile", profile] if profile else []), "--endpoint-url", address]
        )
    return {name: value for name, value in derived.items() if name not in values}


def _address(values: Mapping[str, str], directory: Path) -> str:
    """The bucket's address as far as it is known without asking anybody; empty for Amazon's own."""
    cloud = values.get("DR_CLOUD", "local")
    if cloud in ("remote", "azure"):
        return values.get("DR_REMOTE_MINIO_URL", "")
    if cloud != "local":
        return ""
    state = directory / values.get("DR_S3_DATA_DIR", "data/s3") / ".server.json"
    try:
        return f"http://127.0.0.1:{json.loads(state.read_text('utf-8'))['port']}"
    except (OSError, ValueError, KeyError, TypeError):
        return ""
