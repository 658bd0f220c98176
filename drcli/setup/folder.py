"""Writes a working folder, or an experiment in one, so that a training can start there at once."""

import re
import shlex
import sys
import sysconfig
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.completing.values import Place, worlds
from drcli.config import load_settings
from drcli.envfile import parse_env, with_values
from drcli.errors import SettingsError
from drcli.rewriting import only_writer, rewrite
from drcli.setup.shipped import activate_script, model_file, settings_file

CUSTOM_FILES = ("reward_function.py", "hyperparameters.json", "model_metadata.json")

EXAMPLES = {"OBJECT_AVOIDANCE": "rewards/object_avoidance/", "HEAD_TO_BOT": "rewards/head_to_bot/"}
"""Where the shipped files of a race lie; those of any other race lie on top."""

IGNORED = "/data/"
"""What git shall leave out: bucket, logs and notes of runs."""

_ACTIVATE = """\
# Source this in bash or zsh: source bin/activate.sh [-e EXPERIMENT] [FILE]. Written by `dr init`.
_DR_HOME=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]:-$0}")/.." && pwd) \
_DR_PROGRAMS=%s && . %s "$@"
"""


@dataclass(frozen=True)
class NewFile:
    """A file to write.

    Attributes:
        name: Its path below the working folder.
        data: Its content.
    """

    name: str
    data: bytes


@dataclass(frozen=True)
class FolderPlan:
    """What is about to be written.

    Attributes:
        folder: The working folder, absolute.
        files: Everything that belongs there.
        folders: Folders that belong there even when they are empty.
        warnings: Sentences about what is allowed and may surprise.
    """

    folder: Path
    files: tuple[NewFile, ...]
    folders: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    @property
    def clashes(self) -> list[str]:
        """Files that are there already with another content, by name."""
        return [file.name for file in self.files if _differs(self.folder / file.name, file.data)]


@dataclass(frozen=True)
class FolderReport:
    """What was written.

    Attributes:
        folder: The working folder.
        written: Files, by their path below it.
        unchanged: Files that were as they should be.
        backups: Copies of files that were replaced.
        warnings: Sentences about what is allowed and may surprise.
    """

    folder: str
    written: list[str]
    unchanged: list[str]
    backups: list[str]
    warnings: list[str]


def plan_folder(folder: Path, values: Mapping[str, str]) -> FolderPlan:
    """Work out a working folder; nothing is written yet.

    Args:
        folder: Where it shall be; it need not exist.
        values: Texts of settings by DR_ name, as far as they are not to be as shipped.

    Raises:
        SettingsError: A value is wrong.
    """
    folder = folder.absolute()
    system = settings_file("system.env").read_bytes()
    run = settings_file("run.env").read_bytes()
    in_system = _names_in(settings_file("system.env"))
    system = _filled(system, {k: v for k, v in values.items() if k in in_system}, "system.env")
    run = _filled(run, {k: v for k, v in values.items() if k not in in_system}, "run.env")
    _check(folder, {"system.env": system, "run.env": run})
    files = [
        NewFile("run.env", run),
        NewFile("system.env", system),
        *_custom_files("custom_files", values.get("DR_RACE_TYPE", "")),
        NewFile("bin/activate.sh", _activate().encode()),
        NewFile(".gitignore", _gitignore(folder / ".gitignore")),
    ]
    return FolderPlan(folder, tuple(files), ("tracks",), _missing_world(folder, values))


def plan_experiment(folder: Path, name: str, values: Mapping[str, str]) -> FolderPlan:
    """Work out experiments/<name>/, beginning with what the working folder has now.

    The experiment gets a model of its own and a free DR_RUN_ID, so that it can run beside the
    others.

    Args:
        folder: A working folder.
        name: Name of the experiment.
        values: Texts of settings by DR_ name, which differ from those of the working folder.

    Raises:
        SettingsError: A value is wrong, or belongs into system.env, which experiments share.
    """
    folder = folder.absolute()
    if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]*", name):
        raise SettingsError(
            f"--experiment {name}: is no plain folder name.",
            remedy="Use letters, digits and the characters . _ -",
        )
    if not (folder / "run.env").is_file():
        raise SettingsError(
            f"run.env: there is no such file in {folder}, so no experiment can begin with it.",
            remedy="Write the working folder first, with `dr init`.",
        )
    if shared := [key for key in values if key in _names_in(settings_file("system.env"))]:
        raise SettingsError(
            f"{', '.join(shared)}: belongs into system.env, which all experiments share.",
            remedy=f"Change it for all of them: `dr config set {shared[0]}={values[shared[0]]}`.",
        )
    here = f"experiments/{name}"
    wanted = {
        "DR_RUN_ID": str(_free_run_id(folder)),
        "DR_LOCAL_S3_MODEL_PREFIX": name,
        "DR_LOCAL_S3_CUSTOM_FILES_PREFIX": f"custom_files/{name}",
        **values,
    }
    run = _filled((folder / "run.env").read_bytes(), wanted, "run.env")
    _check(folder, {"run.env": run})
    own = [
        NewFile(f"{here}/custom_files/{file}", (folder / "custom_files" / file).read_bytes())
        for file in CUSTOM_FILES
        if (folder / "custom_files" / file).is_file() and "DR_RACE_TYPE" not in values
    ]
    custom = own or _custom_files(f"{here}/custom_files", values.get("DR_RACE_TYPE", ""))
    files = (NewFile(f"{here}/run.env", run), *custom)
    return FolderPlan(folder, files, (), _missing_world(folder, values))


def write(plan: FolderPlan) -> FolderReport:
    """Write what was planned. What is replaced stays beside it as .bak.

    Raises:
        SettingsError: Something cannot be written.
    """
    written, unchanged, backups = [], [], []
    _make_folders(plan.folder)
    with only_writer(plan.folder):
        for name in plan.folders:
            _make_folders(plan.folder / name)
        for file in plan.files:
            path = plan.folder / file.name
            if path.is_file() and path.read_bytes() == file.data:
                unchanged.append(file.name)
                continue
            _make_folders(path.parent)
            if _differs(path, file.data):
                backups.append(str(_keep(path).relative_to(plan.folder)))
            rewrite(path, file.data)
            written.append(file.name)
    return FolderReport(str(plan.folder), written, unchanged, backups, list(plan.warnings))


def _names_in(file: Path) -> set[str]:
    """Names of a shipped settings file, also those that wait behind a # for a value."""
    return {entry.name for entry in parse_env(_uncommented(file.read_bytes()), file.name).entries}


def _filled(data: bytes, values: Mapping[str, str], name: str) -> bytes:
    """A settings file with values; a line that waits behind a # for its value loses that."""
    lines = data.decode("utf-8").splitlines(keepends=True)
    bare = [_uncommented(line.encode()).decode() for line in lines]
    for index, line in enumerate(bare):
        if line != lines[index] and line.partition("=")[0] in values:
            lines[index] = line
    return with_values("".join(lines).encode(), values, name)


def _uncommented(data: bytes) -> bytes:
    return re.sub(rb"(?m)^# ?(DR_[A-Z0-9_]+=)", rb"\1", data)


def _check(folder: Path, contents: Mapping[str, bytes]) -> None:
    load_settings(folder, environ={}, contents=contents)


def _custom_files(folder: str, race_type: str) -> list[NewFile]:
    examples = EXAMPLES.get(race_type.upper(), "")
    return [
        NewFile(f"{folder}/{name}", model_file(f"{examples}{name}").read_bytes())
        for name in CUSTOM_FILES
    ]


def _activate() -> str:
    beside = Path(sys.executable).parent
    programs = beside if (beside / "dr").exists() else Path(sysconfig.get_path("scripts"))
    return _ACTIVATE % (shlex.quote(str(programs)), shlex.quote(str(activate_script())))


def _gitignore(path: Path) -> bytes:
    """The racer's own lines, if there are any, and ours."""
    before = path.read_bytes() if path.is_file() else b""
    if IGNORED.encode() in before.splitlines():
        return before
    gap = b"\n" if before and not before.endswith(b"\n") else b""
    return before + gap + IGNORED.encode() + b"\n"


def _missing_world(folder: Path, values: Mapping[str, str]) -> tuple[str, ...]:
    world = values.get("DR_WORLD_NAME", "")
    known = set(worlds(Place(folder)))
    if not world or world.endswith(".npy") or re.sub(r"_c?cw$", "", world) in known:
        return ()
    return (
        f"There is no track {world} here yet; fetch it with `dr-tracks fetch {world}`, or choose "
        f"one of {', '.join(sorted(known))}.",
    )


def _free_run_id(folder: Path) -> int:
    """The first number that no run.env of this folder uses."""
    files: Iterable[Path] = (folder / "run.env", *folder.glob("experiments/*/run.env"))
    used = set()
    for file in files:
        entries = parse_env(file.read_bytes(), file.name).entries
        numbers = [entry.value.strip() for entry in entries if entry.name == "DR_RUN_ID"]
        used.add(numbers[-1] if numbers and numbers[-1] else "0")
    return next(number for number in range(len(used) + 1) if str(number) not in used)


def _differs(path: Path, data: bytes) -> bool:
    """Whether something stands where a file shall be, and would be lost."""
    if path.is_dir() or path.name == ".gitignore":  # whose lines are kept
        return False
    return path.is_file() and path.read_bytes() != data


def _keep(path: Path) -> Path:
    """A copy beside a file, under a name that is free."""
    names = (f"{path.name}.bak{number or ''}" for number in range(1000))
    copy = next(path.with_name(name) for name in names if not path.with_name(name).exists())
    rewrite(copy, path.read_bytes())
    return copy


def _make_folders(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise SettingsError(
            f"{path}: this folder cannot be made ({e.strerror or e}).",
            remedy="Choose another folder, or check that you may write there.",
        ) from e
