"""Plans a working folder, or an experiment, in which a training can start at once."""

import os
import re
import shlex
import sys
import sysconfig
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from drcli.base.errors import Place, ProblemsError, SettingsError, shown
from drcli.base.files import hand_out, only_writer, remedy_for, rewrite
from drcli.config.editing import with_any_value
from drcli.config.fields import file_problem, setting_problem
from drcli.config.loading import load_settings
from drcli.config.presets import MODEL_FILES, Preset, activate_script, model_file, settings_file
from drcli.config.race_types import RACE_TYPES
from drcli.config.settings import Settings
from drcli.config.settings_files import EXPERIMENT, content_of, parse_env
from drcli.config.track_names import to_fetch, track_problem
from drcli.config.value_types import FOLDER_NAME

# Writes a planned working folder: all of it or nothing.


@dataclass(frozen=True)
class NewFile:
    """Its name is a path below the working folder."""

    name: str
    data: bytes


@dataclass(frozen=True)
class FolderPlan:
    """What is about to be written; `missing_track` has to be fetched first."""

    folder: Path
    files: tuple[NewFile, ...]
    folders: tuple[str, ...]
    missing_track: str | None = None
    warnings: tuple[str, ...] = ()

    @property
    def clashes(self) -> list[str]:
        """Files that exist with other content."""
        return [file.name for file in self.files if _differs(self.folder / file.name, file.data)]


@dataclass(frozen=True)
class FolderReport:
    """What was written."""

    folder: Annotated[str, "The working folder."]
    written: Annotated[list[str], "Files, by their path below it."]
    unchanged: Annotated[list[str], "Files that were as they should be."]
    backups: Annotated[list[str], "Copies of files that were replaced."]
    warnings: Annotated[list[str], "Things that are allowed but may surprise you."]
    model: Annotated[str, "Address in the bucket of the ready-made model; empty without one."] = ""
    checkpoint: Annotated[str, "Name of its checkpoint."] = ""


def write(plan: FolderPlan) -> FolderReport:
    """Write what was planned. A file that is replaced is kept as .bak.

    Raises:
        ProblemsError: Something is in the way; nothing was written.
        SettingsError: Something cannot be written; all is as it was.
    """
    _refuse_obstacles(plan)
    written, unchanged, backups = [], [], []
    with ExitStack() as undo:
        _make_folders(plan.folder, undo)
        with only_writer(plan.folder):
            for name in plan.folders:
                _make_folders(plan.folder / name, undo)
            for file in plan.files:
                path = plan.folder / file.name
                before = _content(path)
                if before == file.data:
                    unchanged.append(file.name)
                    continue
                _make_folders(path.parent, undo)
                if _differs(path, file.data):
                    copy = _free_name(path)
                    undo.callback(_try, copy.unlink)
                    rewrite(copy, before or b"")
                    backups.append(str(copy.relative_to(plan.folder)))
                if before is None:
                    undo.callback(_try, path.unlink)
                else:
                    undo.callback(_try, rewrite, path, before)
                rewrite(path, file.data)
                written.append(file.name)
        undo.pop_all()  # everything was written
    return FolderReport(str(plan.folder), written, unchanged, backups, list(plan.warnings))


def _refuse_obstacles(plan: FolderPlan) -> None:
    found: dict[Path, str] = {}
    for name in ("", *plan.folders):
        if not (plan.folder / name).is_dir():
            found |= _obstacle(plan.folder / name)
    for file in plan.files:
        path = Path(os.path.realpath(plan.folder / file.name))
        if path.exists() and not path.is_file():
            found[path] = "is not a file, and one has to be written there"
        elif _content(path) == file.data:
            continue
        elif path.is_file() and not os.access(path, os.W_OK):
            found[path] = "is write-protected"
        else:
            found |= _obstacle(path.parent)
    if found:
        remedy = "Move it away or change its rights, or choose another folder."
        raise ProblemsError(
            file_problem(Place(str(path)), f"{what}.", remedy) for path, what in found.items()
        )


def _obstacle(folder: Path) -> dict[Path, str]:
    nearest = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
    if not nearest.is_dir():
        return {nearest: "is not a folder, so nothing can be written in it"}
    if not os.access(nearest, os.W_OK | os.X_OK):
        return {nearest: "is write-protected"}
    return {}


def _try(step: Callable[..., object], *args: object) -> None:
    with suppress(OSError, SettingsError):
        step(*args)


def _differs(path: Path, data: bytes) -> bool:
    if path.name == ".gitignore":  # its lines are kept
        return False
    return _content(path) not in (None, data)


def _content(path: Path) -> bytes | None:
    return content_of(path, str(path)) if path.is_file() else None


def _free_name(path: Path) -> Path:
    names = (f"{path.name}.bak{number or ''}" for number in range(1000))
    return next(path.with_name(name) for name in names if not path.with_name(name).exists())


def _make_folders(path: Path, undo: ExitStack) -> None:
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    for folder in reversed(missing):
        try:
            folder.mkdir(exist_ok=True)
            hand_out(folder)
        except OSError as e:
            raise SettingsError(
                f"{folder}: this folder cannot be created ({e.strerror or e}).",
                remedy=remedy_for(
                    e, folder, "Choose another folder, or check that you can write there."
                ),
            ) from e
        undo.callback(_try, folder.rmdir)


CURRICULUM = "curriculum.yaml"
OVERTAKE = "overtake.py"
"""Near the middle, no car could pass."""

IGNORED = "/data/"
ACTIVATE = "bin/activate.sh"
_FIRST_LINE = (
    "# Source this in bash or zsh: source bin/activate.sh [-e EXPERIMENT] [FILE]. Written by "
    "`dr init`.\n"
)
_ACTIVATE = """\
_DR_HOME=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE:-$0}")/.." && pwd) \
_DR_PROGRAMS=%s && . %s "$@"
"""


def plan_folder(
    folder: Path,
    values: Mapping[str, str],
    preset: Preset | None = None,
    files_of_model: Mapping[str, bytes] | None = None,
) -> FolderPlan:
    """Work out a working folder; nothing is written yet.

    `values` win over `files_of_model` and preset, these over the example files.

    Raises:
        ProblemsError: A value is wrong.
    """
    folder = folder.absolute()
    system = settings_file("system.env").read_bytes()
    run = settings_file("run.env").read_bytes()
    shared = _shared(values)
    system = _filled(system, {name: values[name] for name in shared}, "system.env")
    run = _with_preset(run, preset, values)
    run = _filled(run, {k: v for k, v in values.items() if k not in shared}, "run.env")
    settings = load_settings(folder, environ={}, contents={"system.env": system, "run.env": run})
    files = [
        NewFile("run.env", run),
        NewFile("system.env", system),
        *_custom_files("custom_files", values.get("DR_RACE_TYPE", ""), preset, files_of_model),
        NewFile(ACTIVATE, activate_file()),
        NewFile(".gitignore", _gitignore(folder / ".gitignore")),
    ]
    return FolderPlan(folder, tuple(files), ("tracks",), *_missing_track(settings))


def plan_files(folder: Path, files_of_model: Mapping[str, bytes]) -> FolderPlan:
    """The three files of a model for a working folder that exists."""
    files = _custom_files("custom_files", "", None, files_of_model)
    return FolderPlan(folder.absolute(), tuple(files), ())


def with_curriculum(plan: FolderPlan) -> FolderPlan:
    files = []
    for file in plan.files:
        data, (here, _, name) = file.data, file.name.rpartition("/")
        if name == "run.env":
            data = _filled(data, {"DR_CURRICULUM_FILE": CURRICULUM}, file.name)
            beside = f"{here}/" if here else ""
            overtake = model_file(f"{RACE_TYPES['HEAD_TO_BOT'].rewards}reward_function.py")
            files.append(NewFile(f"{beside}{CURRICULUM}", model_file(CURRICULUM).read_bytes()))
            files.append(NewFile(f"{beside}{OVERTAKE}", overtake.read_bytes()))
        files.append(NewFile(file.name, data))
    return replace(plan, files=tuple(files))


def plan_experiment(
    folder: Path,
    name: str,
    values: Mapping[str, str],
    preset: Preset | None = None,
    files_of_model: Mapping[str, bytes] | None = None,
) -> FolderPlan:
    """Work out experiments/<name>/, a copy of the working folder with another model and run id.

    Raises:
        ProblemsError: A value is wrong, or belongs in system.env, which experiments share.
        SettingsError: The folder is not a working folder.
    """
    folder = folder.absolute()
    _refuse_name(name)
    if not (folder / "run.env").is_file():
        raise SettingsError(
            f"run.env: this file is missing in {folder}; a new experiment copies it.",
            remedy="Create the working folder first with `dr init`.",
        )
    if shared := _shared(values):
        raise ProblemsError(
            setting_problem(
                key,
                Place("system.env"),
                f"{key}={shown(values[key])} belongs in system.env, which all experiments share.",
                f"Leave it out, or change it for all: `dr config set {key}={values[key]}`.",
            )
            for key in shared
        )
    here = f"experiments/{name}"
    wanted = {
        "DR_RUN_ID": str(_free_run_id(folder)),
        "DR_LOCAL_S3_MODEL_PREFIX": name,
        "DR_LOCAL_S3_CUSTOM_FILES_PREFIX": f"custom_files/{name}",
        **values,
    }
    before = content_of(folder / "run.env", "run.env")
    run = _filled(_with_preset(before, preset, wanted), wanted, "run.env")
    # system.env may choose another experiment.
    settings = load_settings(folder, environ={}, flags={EXPERIMENT: ""}, contents={"run.env": run})
    mine = [
        NewFile(f"{here}/custom_files/{file}", content_of(folder / "custom_files" / file, file))
        for file in MODEL_FILES
        if (folder / "custom_files" / file).is_file() and "DR_RACE_TYPE" not in values
    ]
    others = _custom_files(
        f"{here}/custom_files", values.get("DR_RACE_TYPE", ""), preset, files_of_model
    )
    if mine and preset is not None:  # what the preset does not have stays the racer's own
        own = {f"{here}/custom_files/{file}" for file in preset.files}
        kept = [file for file in mine if file.name not in own]
        mine = [*kept, *(file for file in others if file.name in own)]
    custom = others if files_of_model is not None else mine or others
    workers = [
        NewFile(f"{here}/{path.name}", content_of(path, path.name))
        for path in sorted(folder.glob("worker-*.env"))
    ]
    files = (NewFile(f"{here}/run.env", run), *workers, *custom)
    return FolderPlan(folder, files, (), *_missing_track(settings))


def has_activate_script(folder: Path) -> bool:
    """Whether bin/activate.sh is ours; the reference has its own."""
    path = folder / ACTIVATE
    return path.is_file() and content_of(path, path.name).startswith(_FIRST_LINE.encode())


def _shared(values: Mapping[str, str]) -> list[str]:
    data = _uncommented(settings_file("system.env").read_bytes())
    known = parse_env(data, "system.env").last
    return [name for name in values if name in known]


def _filled(data: bytes, values: Mapping[str, str], name: str) -> bytes:
    there = parse_env(data, name).last
    lines = data.splitlines(keepends=True)
    for index, line in enumerate(lines):
        bare = _uncommented(line)
        key = bare.partition(b"=")[0].decode()
        if bare != line and key in values and key not in there:
            lines[index] = bare
    filled = b"".join(lines)
    for key, value in values.items():
        changed = with_any_value(filled, key, value, name)
        if changed is None:
            what = f"{key}={shown(value)} cannot be written into a settings file."
            remedy = "Leave out line breaks, quotes, $ and \\."
            raise ProblemsError([setting_problem(key, Place(name), what, remedy)])
        filled = changed
    return filled


def _uncommented(data: bytes) -> bytes:
    return re.sub(rb"(?m)^# ?(DR_[A-Z0-9_]+=)", rb"\1", data)


def _refuse_name(experiment: str) -> None:
    if not FOLDER_NAME.fullmatch(experiment):
        what = f"{EXPERIMENT}={shown(experiment)} is not a plain folder name."
        remedy = "Use letters, digits and the characters . _ -"
        place = Place(f"experiments/{shown(experiment)}")
        raise ProblemsError([setting_problem(EXPERIMENT, place, what, remedy)])


def _with_preset(data: bytes, preset: Preset | None, values: Mapping[str, str]) -> bytes:
    if preset is None:
        return data
    there = set(parse_env(_uncommented(data), "run.env").last)
    wanted = {name: value for name, value in preset.settings.items() if name not in values}
    filled = _filled(data, {name: wanted[name] for name in wanted if name in there}, "run.env")
    return filled + preset.section(there | set(values))


def _custom_files(
    folder: str,
    race_type: str,
    preset: Preset | None,
    files_of_model: Mapping[str, bytes] | None,
) -> list[NewFile]:
    """In a race with others, its reward function wins over the preset's."""
    if files_of_model is not None:
        return [NewFile(f"{folder}/{name}", files_of_model[name]) for name in MODEL_FILES]
    race = RACE_TYPES.get(race_type.upper())
    examples = race.rewards if race else ""
    mine = {} if preset is None else dict(preset.files)
    if examples:
        mine.pop("reward_function.py", None)
    return [
        NewFile(f"{folder}/{name}", mine.get(name) or model_file(f"{examples}{name}").read_bytes())
        for name in MODEL_FILES
    ]


def activate_file() -> bytes:
    """What bin/activate.sh holds."""
    programs = Path(sys.executable).parent
    if not (programs / "dr").exists():
        programs = Path(sysconfig.get_path("scripts"))
    text = _FIRST_LINE + _ACTIVATE % (
        shlex.quote(str(programs)),
        shlex.quote(str(activate_script())),
    )
    return text.encode()


def _gitignore(path: Path) -> bytes:
    before = content_of(path, path.name) if path.is_file() else b""
    if IGNORED.encode() in before.splitlines():
        return before
    gap = b"\n" if before and not before.endswith(b"\n") else b""
    return before + gap + IGNORED.encode() + b"\n"


def _missing_track(settings: Settings) -> tuple[str | None, tuple[str, ...]]:
    problem = track_problem(settings.race)
    if problem is None:
        return None, ()
    return next(iter(to_fetch([settings.race])), None), (f"{problem.message} {problem.remedy}",)


def _free_run_id(folder: Path) -> int:
    used = set()
    for file in (folder / "run.env", *folder.glob("experiments/*/run.env")):
        name = str(file.relative_to(folder))
        entry = parse_env(content_of(file, name), name).last.get("DR_RUN_ID")
        used.add((entry.value.strip() if entry is not None else "") or "0")
    return next(number for number in range(len(used) + 1) if str(number) not in used)
