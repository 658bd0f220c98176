"""Folders of DeepRacer-for-Cloud: its shell functions win over programs of the same names.

Functions of a shell are not seen by what it starts, so they are judged by the files that define
them: bin/activate.sh, and what a shell reads when it starts.
"""

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import Place, Problem
from drcli.base.files import read_regular
from drcli.config.new_folder import (
    ACTIVATE,
    FolderPlan,
    NewFile,
    activate_file,
    has_activate_script,
)

MARK = b"scripts_wrapper.sh"
"""Defines dr-start-training and the others; its bin/activate.sh sources it."""

EXPORTED = "DR_TRAIN_COMPOSE_FILE"
"""Only its activation exports this."""

PROFILES = (".profile", ".bash_profile", ".bash_login", ".bashrc", ".zprofile", ".zshrc")

_SOURCES = re.compile(
    rb"""^(?P<before>(?:(?:[^#'"]|"[^"]*"|'[^']*')*[;&\s])?(?:source|\.)\s+)(?P<quote>["']?)"""
    rb"""(?P<script>[^"'\s;&|]+/bin/activate\.sh)(?P=quote)(?![^\s;&|)])"""
)


@dataclass(frozen=True)
class LoginLine:
    """A line that loads these functions whenever a shell starts."""

    profile: Path
    number: int
    script: Path

    def __str__(self) -> str:
        return f"~/{self.profile.name} line {self.number}"


def is_reference(script: Path) -> bool:
    """Whether a bin/activate.sh is that of DeepRacer-for-Cloud."""
    try:
        return MARK in read_regular(script)
    except OSError:
        return False


def login_lines(home: Path) -> list[LoginLine]:
    found = []
    for profile in (home / name for name in PROFILES):
        for number, line in enumerate(_lines(profile), 1):
            match = _SOURCES.match(line)
            script = None if match is None else _expanded(match["script"], home)
            if script is not None and is_reference(script):
                found.append(LoginLine(profile, number, script))
    return found


def plan_adoption(folder: Path) -> FolderPlan:
    """Its bin/activate.sh becomes ours; the old one stays beside it as .bak."""
    return FolderPlan(folder.absolute(), (NewFile(ACTIVATE, activate_file()),), ())


def plan_logins(folder: Path, lines: list[LoginLine]) -> FolderPlan:
    """These lines source the bin/activate.sh of an adopted folder instead.

    Args:
        folder: The adopted folder.
        lines: At least one; all in one home.
    """
    script = os.fsencode(folder.absolute() / ACTIVATE)
    home = lines[0].profile.parent
    files = []
    for profile in dict.fromkeys(line.profile for line in lines):
        content = _lines(profile)
        for line in lines:
            if line.profile == profile:
                content[line.number - 1] = _SOURCES.sub(
                    lambda match: match["before"] + b"'" + script.replace(b"'", b"'\\''") + b"'",
                    content[line.number - 1],
                )
        files.append(NewFile(profile.name, b"".join(content)))
    return FolderPlan(home, tuple(files), ())


def winning_functions(
    directory: Path, environ: Mapping[str, str], home: Path | None = None
) -> Iterator[Problem]:
    """V-14: where shell functions of DeepRacer-for-Cloud win over the programs."""

    def problem(place: Place, what: str, remedy: str) -> Problem:
        return Problem("V-14", "warning", *place, what, remedy)

    if is_reference(directory / ACTIVATE):
        what = (
            "bin/activate.sh is that of DeepRacer-for-Cloud: in a shell that sources it, its "
            "functions win over the programs, such as dr-start-training."
        )
        yield problem(Place(ACTIVATE), what, "Run `dr-init --adopt`, which keeps a copy.")
    for line in login_lines(home or Path("~").expanduser()):
        what = (
            f"{line} sources {line.script}, so that every new shell has the functions of "
            "DeepRacer-for-Cloud, which win over the programs."
        )
        remedy = "Run `dr-init --adopt`, which keeps a copy and offers to change that line."
        yield problem(Place(f"~/{line.profile.name}", line.number), what, remedy)
    exported = any(name.startswith("BASH_FUNC_dr-start-training") for name in environ)
    if EXPORTED in environ or exported:
        what = (
            "this shell was activated by DeepRacer-for-Cloud: its functions win over the programs, "
            "and its copies of settings over later changes of the files."
        )
        remedy = (
            "Run `source bin/activate.sh` in this shell, or open a new one."
            if has_activate_script(directory)
            else "Open a new shell, or run `dr-init --adopt` and then `source bin/activate.sh`."
        )
        yield problem(Place("environment"), what, remedy)


def _lines(profile: Path) -> list[bytes]:
    try:
        return read_regular(profile).splitlines(keepends=True)
    except OSError:
        return []


def _expanded(script: bytes, home: Path) -> Path | None:
    """With ~ and $HOME; None if it is relative, or needs another variable."""
    text = os.fsdecode(script)
    text = re.sub(r"^(~|\$HOME|\$\{HOME\})(?=/)", lambda _: str(home), text)
    return Path(text) if text.startswith("/") and "$" not in text else None
