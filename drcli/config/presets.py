"""Presets: files and settings for a purpose."""

import re
from dataclasses import dataclass
from importlib import resources
from itertools import chain, groupby
from pathlib import Path
from typing import Annotated

from drcli.base.errors import SettingsError, one_of, shown
from drcli.base.report import BLANK, Col, Styled, View, bold, dim
from drcli.config.fields import Setting
from drcli.config.settings import Settings, catalogue
from drcli.config.settings_files import parse_env

# The example files for new working folders, installed or in a checkout.


READY_MADE = ("safe", "fast", "car", "unseen")


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


def docs_folder() -> Path:
    package = Path(str(resources.files("drcli")))
    installed = package / "_docs"
    return installed if installed.exists() else package.parent / "docs"


def _found(name: str, folder_in_checkout: str) -> Path:
    package = Path(str(resources.files("drcli")))
    installed = package / "_defaults" / name
    return installed if installed.exists() else package.parent / folder_in_checkout / name


PRESET_SETTINGS = "preset.env"
MODEL_FILES = ("reward_function.py", "hyperparameters.json", "model_metadata.json")

EXAMPLES = {"virtual": "rewards/speed", "unseen": "rewards/speed"}
"""Whose files a preset has where it has none of its own."""


@dataclass(frozen=True)
class Preset:
    """A shipped preset; it need not have all three files, or settings."""

    name: str
    summary: str
    settings: dict[str, str]
    reasons: dict[str, str]
    env: bytes
    files: dict[str, bytes]

    def section(self, without: set[str]) -> bytes:
        """Its settings for run.env, without those that stand there."""
        lines: list[str] = []
        for block in _blocks(self.env.decode()):
            kept = [line for line in block if _name(line) not in without]
            if any(_name(line) for line in kept):
                lines += [*kept, ""]
        if not lines:
            return b""
        heading = f"# --- Preset {self.name} ".ljust(97, "-")
        return "\n".join(["", heading, "", *lines]).encode()


@dataclass(frozen=True)
class Example:
    """The files of a model, to learn from."""

    name: Annotated[str, "Its name, for `dr-init --example`.", Col("example")]
    about: Annotated[str, "What it is for, and what it pays for."]
    file: Annotated[str, "Its reward function."]


@dataclass(frozen=True)
class Examples:
    """The shipped reward functions."""

    examples: Annotated[list[Example], "By name; the one that was named."]
    code: Annotated[str, "The reward function of that one; else empty."] = ""

    def view(self) -> View:
        if self.code:
            yield self.code.rstrip("\n")
            return
        for each in self.examples:
            yield from (bold(each.name), [each.about, dim(each.file)])
        yield "`dr-reward examples NAME` prints one of them,"
        yield "`dr-init --example NAME` puts its three files into custom_files/."


def examples() -> list[Example]:
    folder = model_file("rewards")
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \|", (folder / "README.md").read_text("utf-8"), re.M)
    return [Example(name, text, f"{folder}/{name}/reward_function.py") for name, text in rows]


def example_of(name: str) -> Example:
    """Raises SettingsError: there is none of this name."""
    known = {each.name: each for each in examples()}
    if name not in known:
        what = f"There is no example called {shown(name)}."
        raise SettingsError(what, remedy=one_of(list(known), name))
    return known[name]


def with_code(name: str) -> Examples:
    """Raises SettingsError: there is none of this name."""
    example = example_of(name)
    return Examples([example], Path(example.file).read_text("utf-8"))


def example_files(name: str) -> dict[str, bytes]:
    """The three files of an example.

    Raises:
        SettingsError: There is none of this name.
    """
    example_of(name)
    return {file: model_file(f"rewards/{name}/{file}").read_bytes() for file in MODEL_FILES}


@dataclass(frozen=True)
class PresetValue:
    """A setting of a preset, beside that of the working folder."""

    name: Annotated[str, "Name of the setting."]
    value: Annotated[str, "Its value in the preset."]
    present: Annotated[str | None, "Its value in this working folder; None without one."]
    source: Annotated[
        str | None, "Where the present value comes from; None without a working folder."
    ]
    default: Annotated[str, "Its default."]
    meaning: Annotated[str, "What it does."]
    reason: Annotated[str, "Why the preset has it."]

    def parts(self) -> View:
        yours = ""
        if self.present is not None and self.present != self.value:
            yours = f"  # here {shown(self.present) or 'empty'}, {self.source}"
        return (f"{self.name}={self.value}", Styled(yours, "yellow")), [dim(self.meaning)]


@dataclass(frozen=True)
class PresetReport:
    """What `dr config preset` shows of a preset."""

    name: Annotated[str, "Its name."]
    summary: Annotated[str, "What it is for."]
    files: Annotated[tuple[str, ...], "Its files of a model."]
    settings: Annotated[tuple[PresetValue, ...], "Its settings."]


@dataclass(frozen=True)
class PresetReports:
    """What `dr config preset` shows."""

    presets: Annotated[tuple[PresetReport, ...], "The presets, by name."]

    def view(self, *, in_full: bool) -> View:
        for number, preset in enumerate(self.presets):
            yield from (number and BLANK, bold(preset.name))
            yield [preset.summary, dim(f"Files: {', '.join(preset.files) or 'none'}.")]
            groups = groupby(preset.settings, lambda value: value.reason) if in_full else ()
            for reason, group in groups:
                parts = chain.from_iterable(value.parts() for value in group)
                yield from (BLANK, [reason and dim(f"# {reason}"), *parts])
        if not in_full:
            yield from (BLANK, dim("`dr config preset NAME` shows the settings of one."))


def preset_names() -> list[str]:
    folder = presets_folder()
    return sorted(path.name for path in folder.iterdir() if path.is_dir() and _files(path))


def preset_of(name: str) -> Preset:
    """A shipped preset by its name, in any letter case.

    Raises:
        SettingsError: There is none of this name.
    """
    names = preset_names()
    if name.casefold() not in names:
        what = f"There is no preset called {shown(name)}."
        raise SettingsError(what, remedy=one_of(names, name.casefold()))
    folder = presets_folder() / name.casefold()
    found = {path.name: path.read_bytes() for path in _files(folder)}
    data = found.get(PRESET_SETTINGS, b"")
    files = {file: found[file] for file in MODEL_FILES if file in found}
    entries = parse_env(data, PRESET_SETTINGS).last
    return Preset(
        folder.name,
        _summary(data.decode(), list(files)),
        {key: entry.value for key, entry in entries.items()},
        _reasons(data.decode()),
        data,
        files,
    )


def explain(names: list[str], settings: Settings | None) -> PresetReports:
    """Some presets, or all, beside the settings of a working folder.

    Raises:
        SettingsError: There is no preset of a name.
    """
    return PresetReports(
        tuple(_report(preset_of(name), settings) for name in names or preset_names())
    )


def _report(preset: Preset, settings: Settings | None) -> PresetReport:
    values = tuple(
        _value(catalogue()[name], value, preset.reasons.get(name, ""), settings)
        for name, value in preset.settings.items()
    )
    return PresetReport(preset.name, preset.summary, tuple(preset.files), values)


def _value(setting: Setting, value: str, reason: str, settings: Settings | None) -> PresetValue:
    present = source = None
    if settings is not None:
        present, source = str(getattr(settings, setting.field)), settings.source(setting.name)
    read = str(setting.read(value))
    return PresetValue(
        setting.name, read, present, source, setting.default_text, setting.meaning, reason
    )


def _files(folder: Path) -> list[Path]:
    own = {path.name: path for path in folder.iterdir()}
    if folder.name in EXAMPLES:
        own = {path.name: path for path in model_file(EXAMPLES[folder.name]).iterdir()} | own
    return [own[name] for name in (PRESET_SETTINGS, *MODEL_FILES) if name in own]


def _summary(text: str, files: list[str]) -> str:
    first = text.partition("\n")[0]
    return first.removeprefix("#").strip() or f"Its own {' and '.join(files)}."


def _blocks(text: str) -> list[list[str]]:
    return [block.splitlines() for block in text.split("\n\n") if block.strip()]


def _name(line: str) -> str:
    return "" if line.startswith("#") else line.partition("=")[0].strip()


def _reasons(text: str) -> dict[str, str]:
    reasons: dict[str, str] = {}
    for block in _blocks(text):
        comment = " ".join(line.lstrip("# ") for line in block if line.startswith("#"))
        reasons |= {name: comment for line in block if (name := _name(line))}
    return reasons
