"""What a simulation log says is read by log-guru and deepracer-utils in every state."""

import json
import warnings
from dataclasses import replace

import pytest

from drcli.base.log import LogFile
from drcli.config.loading import load_settings
from drcli.drive.driving import log_evaluation, log_training
from drcli.drive.reference_log import evaluation_lines, start_lines, training_lines
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.records.trace import Episode, Row

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
def started(tmp_path):
    """The first lines of a simulation log."""

    def start(race_type: str = "TIME_TRIAL", **metadata) -> str:
        (tmp_path / "run.env").write_text(
            f"DR_LOCAL_S3_MODEL_PREFIX=model-1\nDR_RACE_TYPE={race_type}\n"
        )
        (tmp_path / "system.env").write_text("")
        model = ModelMetadata.from_bytes(json.dumps({**METADATA, **metadata}).encode(), "m")
        settings = load_settings(tmp_path, environ={})
        lines = start_lines("model-1", settings.race, model, Hyperparameters(), "TRAINING")
        return lines + "\n"

    return start


def driven(number: int, end: str = "off_track", action: str = "1", **last) -> Episode:
    """An episode of three steps."""
    rows = [
        replace(ROW, steps=1, status="prepare", action=action, reward=0.0),
        replace(ROW, steps=2, action=action),
        replace(ROW, steps=3, action=action, done=True, status=end, **last),
    ]
    return Episode(number, "training", rows, track_length_m=17.7)


def lap(number: int, progress: float = 100.0) -> Episode:
    end = "lap_complete" if progress == 100.0 else "off_track"
    return Episode(number, "evaluation", driven(number, end, progress=progress).rows)


def trained(*episodes: Episode, worker: int = 0) -> str:
    return training_lines(episodes, worker, 0, 0, 1.0) + "\n"


def evaluated(*laps: Episode, last_episode: int = 2) -> str:
    return evaluation_lines(laps, 0, last_episode, 6, 0) + "\n"


@pytest.mark.parametrize("laps", [[100.0], [40.0], [100.0, 40.0, 100.0]])
def test_an_evaluation_is_read_whether_its_laps_were_completed_or_not(started, log_guru, laps):
    log = started()
    for first in (0, 2):
        log += trained(driven(first), driven(first + 1))
        log += evaluated(*(lap(k, p) for k, p in enumerate(laps)))

    reading = log_guru(log)

    assert [progress for _, progress in reading.evaluations] == [laps, laps]
    assert reading.iterations == [0, 0, 1, 1]
    assert (reading.model, reading.parameters) == (
        "model-1",
        {"JOB_TYPE": "TRAINING", "RACE_TYPE": "TIME_TRIAL", "WORLD_NAME": "reinvent_base"},
    )


def test_the_true_success_rate_stands_below_the_constant_of_the_format(started, log_guru):
    told = evaluated(lap(0), lap(1), lap(2, 40.0))

    assert "2 of 3 evaluation episodes completed the lap: success rate 0.67." in told
    assert told.index("success rate 0.67") > told.rindex("Success rate = 0.0")
    assert len(log_guru(started() + trained(driven(0)) + told).evaluations) == 1


def test_the_log_of_a_worker_that_does_not_evaluate_is_read(started, log_guru):
    reading = log_guru(started("OBJECT_AVOIDANCE") + trained(driven(0), driven(1), worker=1))

    assert len(reading.episodes) == 2
    assert reading.parameters["RACE_TYPE"] == "OBJECT_AVOIDANCE"


def test_actions_of_ranges_are_read(started, log_guru):
    intro = started(action_space=RANGES, action_space_type="continuous")

    reading = log_guru(intro + trained(driven(0, action="[-12.5 1.75]")))

    assert reading.actions == RANGES
    assert reading.episodes[0][1]["action"] == "[-12.5 1.75]"


@pytest.mark.parametrize("end", ["off_track", "crashed", "reversed", "immobilized"])
@pytest.mark.parametrize("progress", [0.0, -0.00001, 0.00004, -0.3])
def test_an_episode_that_gets_nowhere_is_read(started, log_guru, end, progress):
    reading = log_guru(started() + trained(driven(0, end, progress=progress)))

    assert float(reading.episodes[0][-1]["progress"]) == pytest.approx(progress, abs=2e-4)


def test_what_a_reward_function_prints_without_ending_its_line_hides_no_step(started, log_guru):
    log = started() + "." * 7 + trained(driven(0)) + "half a line" + evaluated(lap(0))

    reading = log_guru(log)

    assert (len(reading.episodes), len(reading.evaluations)) == (1, 1)


def test_the_line_of_each_episode_and_its_records_hide_no_step(started, log_guru, tmp_path):
    def logged(*episodes):
        path = tmp_path / "sim-0.log"
        file = LogFile(path, 1 << 20)
        for episode in episodes:
            log_training(episode, 0, 0)
            log_evaluation(lap(episode.number), 0, 0)
        file.end()
        text = path.read_text()
        path.unlink()
        return text

    log = started() + logged(driven(0), driven(1)) + trained(driven(0), driven(1))
    log += logged(driven(2)) + evaluated(lap(0)) + trained(driven(2))

    reading = log_guru(log)

    assert (len(reading.episodes), reading.iterations) == (3, [0, 0, 1])


def test_a_log_that_goes_on_after_a_resume_is_read(started, log_guru):
    log = started() + trained(driven(0)) + evaluated(lap(0))
    log += started() + trained(driven(1)) + evaluated(lap(0))

    assert log_guru(log).iterations == [0, 1]


def test_deepracer_utils_reads_the_same_log(started, tmp_path):
    path = tmp_path / "sim-0.log"
    log = trained(driven(0)) + evaluated(lap(0)) + trained(driven(1)) + evaluated(lap(0))
    path.write_text(started() + log)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from deepracer.logs.log_utils import SimulationLogsIO

        frame = SimulationLogsIO.load_pandas(str(path), episodes_per_iteration=1)

    assert list(frame["episode"]) == [0] * 3 + [1] * 3
    assert list(frame["action"]) == [1] * 6
    assert list(frame["episode_status"]) == ["prepare", "in_progress", "off_track"] * 2
