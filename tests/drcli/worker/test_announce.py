"""What a simulation log says is read by log-guru and deepracer-utils in every state."""

import json
import warnings
from dataclasses import replace

import pytest

from drcli.config import load_settings
from drcli.hyperparameters import Hyperparameters
from drcli.model_metadata import ModelMetadata
from drcli.worker.announce import EpisodeLog, start_lines
from drcli.worker.trace import Episode, Row

METADATA = {
    "action_space": [
        {"steering_angle": 20.0, "speed": 1.5, "index": 1},
        {"steering_angle": -20.0, "speed": 1.5, "index": 0},
    ],
    "action_space_type": "discrete",
    "sensor": ["FRONT_FACING_CAMERA"],
    "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
    "training_algorithm": "clipped_ppo",
    "version": "5",
}
RANGES = {
    "speed": {"low": 1.0, "high": 4.0},
    "steering_angle": {"low": -30.0, "high": 30.0},
}
ROW = Row(1, 1.0, 2.0, 3.0, 20.0, 1.5, "1", 0.5, False, True, 5.0, 7, "in_progress", 0.0, 0.1)


@pytest.fixture
def started(tmp_path, capsys):
    """The first lines of a simulation log."""

    def start(race_type: str = "TIME_TRIAL", **metadata) -> str:
        (tmp_path / "run.env").write_text(
            f"DR_LOCAL_S3_MODEL_PREFIX=model-1\nDR_RACE_TYPE={race_type}\n"
        )
        (tmp_path / "system.env").write_text("")
        model = ModelMetadata.from_bytes(json.dumps({**METADATA, **metadata}).encode(), "m")
        settings = load_settings(tmp_path, environ={})
        return start_lines(settings, model, Hyperparameters(), "TRAINING") + "\n"

    return start


def driven(number: int, end: str = "off_track", action: str = "1", **last) -> Episode:
    """An episode of three steps."""
    rows = [
        replace(ROW, steps=1, status="prepare", action=action, reward=0.0),
        replace(ROW, steps=2, action=action),
        replace(ROW, steps=3, action=action, done=True, status=end, **last),
    ]
    return Episode(number, "training", rows)


def lap(number: int, progress: float = 100.0) -> Episode:
    end = "lap_complete" if progress == 100.0 else "off_track"
    return Episode(number, "evaluation", driven(number, end, progress=progress).rows)


@pytest.mark.parametrize("laps", [[100.0], [40.0], [100.0, 40.0, 100.0]])
def test_an_evaluation_is_read_whether_its_laps_were_completed_or_not(
    started, capsys, log_guru, laps
):
    log = EpisodeLog(0, 17.7, 0, 0)
    for iteration in range(2):
        first = 2 * iteration
        log.training([driven(first), driven(first + 1)], 0, iteration, 1.0)
        log.evaluation([lap(k, p) for k, p in enumerate(laps)], first + 2, 6, iteration)

    reading = log_guru(started() + capsys.readouterr().out)

    assert [progress for _, progress in reading.evaluations] == [laps, laps]
    assert reading.iterations == [0, 0, 1, 1]
    assert (reading.model, reading.parameters) == (
        "model-1",
        {"JOB_TYPE": "TRAINING", "RACE_TYPE": "TIME_TRIAL", "WORLD_NAME": "reinvent_base"},
    )


def test_the_log_of_a_worker_that_does_not_evaluate_is_read(started, capsys, log_guru):
    EpisodeLog(1, 17.7, 0, 0).training([driven(0), driven(1)], 0, 0, 1.0)

    reading = log_guru(started("OBJECT_AVOIDANCE") + capsys.readouterr().out)

    assert len(reading.episodes) == 2
    assert reading.parameters["RACE_TYPE"] == "OBJECT_AVOIDANCE"


def test_actions_of_ranges_are_read(started, capsys, log_guru):
    EpisodeLog(0, 17.7, 0, 0).training([driven(0, action="[-12.5 1.75]")], 0, 0, 1.0)

    intro = started(action_space=RANGES, action_space_type="continuous")
    reading = log_guru(intro + capsys.readouterr().out)

    assert reading.actions == RANGES
    assert reading.episodes[0][1]["action"] == "[-12.5 1.75]"


@pytest.mark.parametrize("end", ["off_track", "crashed", "reversed", "immobilized"])
@pytest.mark.parametrize("progress", [0.0, -0.00001, 0.00004, -0.3])
def test_an_episode_that_gets_nowhere_is_read(started, capsys, log_guru, end, progress):
    EpisodeLog(0, 17.7, 0, 0).training([driven(0, end, progress=progress)], 0, 0, 1.0)

    reading = log_guru(started() + capsys.readouterr().out)

    assert float(reading.episodes[0][-1]["progress"]) == pytest.approx(progress, abs=2e-4)


def test_what_a_reward_function_prints_without_ending_its_line_hides_no_step(
    started, capsys, log_guru
):
    print("." * 7, end="")
    log = EpisodeLog(0, 17.7, 0, 0)
    log.training([driven(0)], 0, 0, 1.0)
    print("half a line", end="")
    log.evaluation([lap(0)], 1, 3, 0)

    reading = log_guru(started() + capsys.readouterr().out)

    assert (len(reading.episodes), len(reading.evaluations)) == (1, 1)


def test_an_iteration_that_is_driven_again_after_a_resume_is_in_the_log_once(
    started, capsys, log_guru
):
    before = EpisodeLog(0, 17.7, 0, 0)
    before.training([driven(0), driven(1)], 0, 0, 1.0)
    before.evaluation([lap(0)], 2, 6, 0)
    before.training([driven(2), driven(3)], 6, 1, 2.0)  # and stopped before it was learned from
    resumed = started()
    after = EpisodeLog(0, 17.7, episodes=4, evaluated=2)
    after.training([driven(2), driven(3)], 6, 1, 3.0)
    after.evaluation([lap(0)], 4, 12, 1)
    after.training([driven(2), driven(3)], 6, 1, 4.0)  # its rollouts were lost
    after.evaluation([lap(0)], 4, 12, 1)
    after.training([driven(4), driven(5)], 12, 2, 5.0)

    reading = log_guru(started() + resumed + capsys.readouterr().out)

    assert [int(steps[0]["episode"]) for steps in reading.episodes] == [0, 1, 2, 3, 4, 5]
    assert reading.iterations == [0, 0, 1, 1, 2, 2]


def test_deepracer_utils_reads_the_same_log(started, capsys, tmp_path):
    log = EpisodeLog(0, 17.7, 0, 0)
    for iteration in range(2):
        log.training([driven(iteration)], 0, iteration, 1.0)
        log.evaluation([lap(0)], iteration + 1, 3, iteration)
    path = tmp_path / "sim-0.log"
    path.write_text(started() + capsys.readouterr().out)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from deepracer.logs.log_utils import SimulationLogsIO

        frame = SimulationLogsIO.load_pandas(str(path), episodes_per_iteration=1)

    assert list(frame["episode"]) == [0] * 3 + [1] * 3
    assert list(frame["action"]) == [1] * 6
    assert list(frame["episode_status"]) == ["prepare", "in_progress", "off_track"] * 2
