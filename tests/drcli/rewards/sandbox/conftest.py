"""Calls that reward functions are tried with: two short episodes on a track."""

from collections.abc import Callable
from pathlib import Path

import pytest

from drcli.rewards.sandbox.run_sandbox import SandboxRequest, SandboxResult
from drcli.rewards.sandbox.sample_calls import sample_params
from drcli.rewards.sandbox.sandbox_process import calls_of
from drsim.track.track import Track
from drsim.track.worlds import load_track
from sandbox_here import without_trial

STEPS = 40


@pytest.fixture(scope="session")
def track() -> Track:
    """A short one."""
    return load_track("bean")


@pytest.fixture
def request_of(track: Track) -> Callable[..., SandboxRequest]:
    """A request for two episodes of so many steps."""

    def make(steps: int = STEPS, **options: object) -> SandboxRequest:
        calls = sample_params(track)
        episodes = [calls[:STEPS][:steps], calls[STEPS : 2 * STEPS][:steps]]
        for episode in episodes:
            for step, params in enumerate(episode):
                del params["waypoints"]
                params["steps"] = float(step + 2)
        return SandboxRequest(
            "mine.py",
            episodes,
            [way.waypoints for way in (track, track.reversed())],
            repeated=2,
            **options,
        )

    return make


@pytest.fixture
def found(
    request_of: Callable[..., SandboxRequest], tmp_path: Path
) -> Callable[..., SandboxResult]:
    """What the sandbox finds about a file, in this process."""

    def find(text: str, *, steps: int = STEPS) -> SandboxResult:
        file = tmp_path / "reward_function.py"
        file.write_text(text)
        request = request_of(steps)
        with (tmp_path / "faults.txt").open("w") as faults:
            return without_trial(request, file, calls_of(request), faults)

    return find
