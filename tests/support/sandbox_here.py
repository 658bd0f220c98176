"""The sandbox of reward functions in this process, which is much quicker than one of its own."""

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import ClassVar, TextIO

import pytest

from drcli.base.errors import ProblemsError
from drcli.config.run_config import DriveConfig
from drcli.rewards.course import Course
from drcli.rewards.sandbox import sandbox_process
from drcli.rewards.sandbox.run_sandbox import SandboxRequest, SandboxResult
from drcli.rewards.sandbox.sandbox_process import Calls, calls_of, try_function
from drcli.rewards.scripted_drive import Drive, drive
from drsim.car.actions import Actions


class NothingShared:
    """In place of the trial of state that cars share, which copies the whole process four times."""

    def __init__(self, *_: object) -> None:
        pass

    def __enter__(self) -> "NothingShared":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def result(self) -> None:
        pass


def without_trial(
    request: SandboxRequest, file: Path, calls: Calls, faults: TextIO
) -> SandboxResult:
    """What `try_function` finds, but for state that cars share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sandbox_process, "SharedStateTrial", NothingShared)
        return try_function(request, file, calls, faults)


_DRIVES: dict[str, Drive] = {}


def driven_once(own: DriveConfig, actions: Actions | None) -> Drive:
    """As many tests try other functions on the same track."""
    elsewhere = {"sources", "directory", "tracks_dir"}
    values = {name: value for name, value in own.to_json().items() if name not in elsewhere}
    key = f"{json.dumps(values, sort_keys=True)} {actions}"
    if any(own.tracks_folder.glob(f"{own.world_name}.*")):
        return drive(own, actions)
    if key not in _DRIVES:
        _DRIVES[key] = drive(own, actions)
    return _DRIVES[key]


class SandboxHere:
    """The sandbox in this process; `options` change its requests."""

    options: ClassVar[dict[str, float]] = {}

    def __init__(self, request: SandboxRequest, content: bytes | None, _directory: Path) -> None:
        self.course: Course | None = None
        self._request = replace(request, **self.options)
        self._content = content

    def __enter__(self) -> "SandboxHere":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def result(self, _given_up: Event | None = None) -> SandboxResult:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sandbox_process, "drive", driven_once)
            try:
                calls = calls_of(self._request)
            except ProblemsError as error:
                return SandboxResult(problems=[*error.problems])
        self.course = calls.course
        if self._content is None:
            return SandboxResult(problems=calls.problems)
        with TemporaryDirectory() as scratch:
            file = Path(scratch, "reward_function.py")
            file.write_bytes(self._content)
            with Path(scratch, "faults.txt").open("w") as faults:
                return without_trial(self._request, file, calls, faults)
