"""The settings of a working folder as variables of a shell."""

import json
import shlex
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import BadValue, ProblemsError
from drcli.config import activation
from drcli.config.loading import leave_out_slashes
from drcli.config.settings import catalogue
from drcli.config.settings_files import EXPERIMENT, Layers, SettingsFiles, given

OURS = (activation.FOLDER, activation.RUN_FILE, activation.MARK)


@dataclass(frozen=True)
class ShellChange:
    """What activation changes in a shell."""

    export: Mapping[str, str]
    unset: tuple[str, ...]
    warnings: tuple[str, ...]

    def script(self) -> str:
        lines = [f"unset {name}\n" for name in self.unset]
        lines += [f"export {name}={shlex.quote(value)}\n" for name, value in self.export.items()]
        return "".join(lines)


def shell_change(
    directory: Path, environ: Mapping[str, str], *, experiment: str = ""
) -> ShellChange:
    """What the files of a working folder mean for a shell, unchecked.

    What somebody exported by hand wins over the files.

    Raises:
        SettingsError: A file is missing, or a line of it cannot be read.
    """
    by_hand = activation.chosen(environ)
    outside = given(by_hand, "environment")
    if experiment:
        outside |= given({EXPERIMENT: experiment}, "-e")
    files = SettingsFiles(directory)
    system = files.read("system.env") if files.exist("system.env") else {}
    name = files.run_file([outside], files.experiment([outside, system]))
    run = files.read(name)
    if any(problem.severity == "error" for problem in files.problems):
        raise ProblemsError(files.problems)

    deque(leave_out_slashes([outside, run, system]), maxlen=0)  # each command warns of them
    names = [key for key in {**system, **run} if key not in outside and key not in OURS]
    defaults = {key: setting.default_text for key, setting in catalogue().items()}
    layers = Layers([outside, run, system], defaults)
    texts = {key: _as_used(key, layers.text(key) or "") for key in names}
    if texts.get("DR_CLOUD") == "azure" and not {**by_hand, **texts}.get("DR_REMOTE_MINIO_URL"):
        texts["DR_CLOUD"] = "local"
    copies = {**_derived({**by_hand, **texts}, directory), **texts}
    export = {
        activation.FOLDER: str(directory),
        activation.RUN_FILE: str(directory / name),
        **({EXPERIMENT: experiment} if experiment else {}),
        **copies,
        activation.MARK: activation.marked(copies),
    }
    unset = activation.copies(environ) - export.keys()
    warnings = tuple(str(problem) for problem in layers.problems.values())
    return ShellChange(export, tuple(sorted(unset)), warnings)


def _as_used(name: str, text: str) -> str:
    """A text as the commands read it, such as TIME_TRIAL for time_trial."""
    setting = catalogue().get(name)
    if setting is None or setting.kind not in ("text", "choice"):
        return text
    with suppress(BadValue):
        return str(setting.read(text))
    return text


def _derived(values: Mapping[str, str], directory: Path) -> dict[str, str]:
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
    """Without a request; empty for Amazon's own."""
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
