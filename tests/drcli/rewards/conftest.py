"""Drives that are driven once for all tests, and functions that are tried on them."""

from collections.abc import Callable
from pathlib import Path

import pytest

from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.model.files.custom_files import InputFile
from drcli.rewards.course import LATE, STEADY
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import read_source
from drcli.rewards.sandbox.run_sandbox import SandboxResult
from drcli.rewards.scripted_drive import drive
from drcli.rewards.track_grid import DrivenCourse
from drcli.rewards.tried_reward import TriedReward
from drsim.episode.reward import RewardFunction


@pytest.fixture(scope="session")
def settings_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Settings]:
    """Settings of a folder of its own, by DR_ name."""

    def make(**values: str) -> Settings:
        folder = tmp_path_factory.mktemp("racer")
        (folder / "system.env").write_text("DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\n")
        (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
        return load_settings(folder, flags={"DR_WORLD_NAME": "bean", **values}, environ={})

    return make


@pytest.fixture(scope="session")
def course(settings_of: Callable[..., Settings]) -> DrivenCourse:
    """A time trial on a short track."""
    return DrivenCourse.of(drive(settings_of().race))


@pytest.fixture(scope="session")
def obstacle_course(settings_of: Callable[..., Settings]) -> DrivenCourse:
    """Boxes on the road, and the other way round after every episode."""
    return DrivenCourse.of(
        drive(
            settings_of(
                DR_RACE_TYPE="OBJECT_AVOIDANCE",
                DR_TRAIN_ALTERNATE_DRIVING_DIRECTION="True",
            ).race
        )
    )


@pytest.fixture
def with_result(course: DrivenCourse) -> Callable[..., TriedReward]:
    """A function of which this was found."""

    def make(result: SandboxResult, text: str = "", name: str = "mine.py") -> TriedReward:
        source, _ = read_source(InputFile("reward_function.py", text.encode(), name))
        assert source is not None
        problems = problems_of(source, result, Path())
        return TriedReward(name, course.course, result, source.words, problems)

    return make


@pytest.fixture
def tried_of(
    course: DrivenCourse, with_result: Callable[..., TriedReward]
) -> Callable[[RewardFunction], TriedReward]:
    """A function called along the course, here, with what it returns and nothing else."""

    def call(function: RewardFunction) -> TriedReward:
        waypoints = course.drive.waypoints()
        values = [
            [function({**call, "waypoints": waypoints[call["is_reversed"]]}) for call in calls]
            for calls in course.course.sequences
        ]
        late = {**course.drive.trip(STEADY).calls[0], "steps": 2_000.0}
        late["waypoints"] = waypoints[False]
        samples = [function(late)] * -LATE
        return with_result(SandboxResult(values=[*values, samples]))

    return call
