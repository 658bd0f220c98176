"""Drives that are driven once for all tests, and functions that are tried on them."""

from collections.abc import Callable
from pathlib import Path

import pytest

from drcli.checks.sandbox.recording import testify as testify_to
from drcli.checks.sandbox.statement import Order, Statement
from drcli.config.settings import Settings, load_settings
from drcli.rewards.scripted_drive import drive
from drcli.rewards.trial import Course, Trial
from drsim.episode.reward import RewardFunction


class NoGuard:
    """Nothing is guarded: a test that hangs is ended by pytest."""

    def begin(self, limit_s: float) -> None:
        pass

    def end(self) -> None:
        pass


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
def course(settings_of: Callable[..., Settings]) -> Course:
    """A time trial on a short track."""
    return Course.of(drive(settings_of().race))


@pytest.fixture(scope="session")
def obstacle_course(settings_of: Callable[..., Settings]) -> Course:
    """Boxes on the road, and the other way round after every episode."""
    return Course.of(
        drive(
            settings_of(
                DR_RACE_TYPE="OBJECT_AVOIDANCE",
                DR_TRAIN_ALTERNATE_DRIVING_DIRECTION="True",
            ).race
        )
    )


@pytest.fixture
def trial_of(course: Course) -> Callable[[RewardFunction], Trial]:
    """A function called along the course, here, with what it returns and nothing else."""

    def call(function: RewardFunction) -> Trial:
        waypoints = course.drive.waypoints()
        sequences = course.questions().sequences
        values = [
            [function({**call, "waypoints": waypoints[call["is_reversed"]]}) for call in calls]
            for calls in sequences
        ]
        return Trial("mine.py", course, Statement(values=values, made=course.size))

    return call


@pytest.fixture
def testify(course: Course, tmp_path: Path) -> Callable[..., Statement]:
    """What a witness has to say about a file, after two short episodes, in this process."""

    def hear(text: str, *, steps: int = 40) -> Statement:
        file = tmp_path / "reward_function.py"
        file.write_text(text)
        trips = [trip.calls[:steps] for trip in course.drive.trips[:2]]
        order = Order(
            file=str(file), sequences=trips, repeated=2, waypoints=course.drive.waypoints()
        )
        with (tmp_path / "faults.txt").open("w") as faults:
            return testify_to(order, faults, NoGuard())

    return hear
