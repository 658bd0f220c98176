"""Grids of disturbances driven by a real simulation with an untrained policy."""

import json

import pytest
from safetensors.torch import save

from drcli.drive.evaluate_many import PLACES, Cell, drive_cells
from drcli.drive.evaluator import entries, start_of
from drcli.records.job import Job
from drcli.workers.worker_process import StopRequested
from drsim.car.conditions import Conditions
from drsim.track.worlds import load_track
from small_policies import metadata_json, small_metadata, small_network


class Untold:
    """A stop_signal that asks nobody to stop before so many steps."""

    def __init__(self, steps=10**9):
        self._left = steps

    def should_stop(self):
        return False

    def step_done(self):
        self._left -= 1
        return self._left < 0


@pytest.fixture
def drive(racer, tmp_path):
    """Drives cells with a network that is not trained, for a second each."""
    racer.model_metadata(**json.loads(metadata_json()))
    racer.run_env(*RUN)
    racer.start()
    weights = small_network(small_metadata()).state_dict()
    tensors = save({name: tensor.contiguous() for name, tensor in weights.items()})
    racer.store("model-1").save(0, 0, tensors, optimizer=b"")

    def drive(*cells, stop_signal=None, unseen=()):
        config = racer.settings().run
        job = Job(config, "s", 3, None, tmp_path, launcher_pid=1)
        [entry] = entries(config, "20260102030405", ["0_Step-0.ckpt"])
        races = [config.race().replaced(world_name=name) for name in unseen]
        return drive_cells(
            job, stop_signal or Untold(), racer.bucket, entry, config, cells, races, threads=1
        )

    return drive


RUN = ("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_EVAL_MAX_LAP_SECONDS=1.2")
CELLS = (
    Cell("none", "none"),
    Cell("battery", "x 0.5", Conditions(battery=0.5)),
    Cell("direction", "the other way", other_way=True),
    Cell("start", "left", side="left"),
    Cell("latency", "0.2 s", Conditions(latency_s=0.2)),
    Cell("noise", "40 greys", Conditions(image_noise=40.0)),
)


def test_each_disturbance_changes_the_drive_and_the_same_seed_repeats_it(drive):
    first, again = drive(*CELLS), drive(*CELLS)

    assert first == again
    assert [(cell.axis, cell.trials) for cell in first] == [(c.axis, PLACES) for c in CELLS]
    assert len({cell.progress for cell in first}) == len(first)
    assert all(cell.completed == 0 and cell.ended_by for cell in first)
    assert 0.0 < first[1].progress < first[0].progress  # a weak battery gets less far in time


def test_another_track_is_driven_in_the_same_grid(drive):
    cells = Cell("none", "none"), Cell("unseen tracks", "willow", track=1)

    [own, other] = drive(*cells, unseen=["willow"])

    assert own.progress != other.progress
    assert (other.axis, other.level, other.trials) == ("unseen tracks", "willow", PLACES)


def test_a_car_with_the_gray_overlay_has_it_under_every_level(drive, racer):
    overlaid = Cell("none", "none", Conditions(gray_overlay=True))
    wanted, other = drive(overlaid), drive(Cell("none", "none"))
    racer.run_env(*RUN, "DR_SIM_GRAY_OVERLAY=1")

    assert drive(Cell("none", "none")) == wanted != other


def test_a_grid_stops_when_it_is_told_to(drive):
    with pytest.raises(StopRequested):
        drive(*CELLS, stop_signal=Untold(3))


def test_a_start_off_the_road_is_moved_and_said(racer):
    """003-18."""
    track = load_track("reinvent_base")
    racer.run_env("DR_EVAL_START_OFFSET=5", "DR_EVAL_START_ANGLE=10", "DR_EVAL_START_POSITION=0.5")

    plan, [note] = start_of(racer.settings().run.evaluation, track)

    assert (plan.start_fraction, plan.angle_deg) == (0.5, 10.0)
    assert 0.2 < plan.offset_m < 0.6
    assert note == (
        "A start 5.00 m to the left of the centre line (DR_EVAL_START_OFFSET=5) would stand off "
        f"reinvent_base; the car starts {plan.offset_m:.2f} m to the left."
    )


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_side_of_the_track_follows_the_driving_direction(racer, side):
    track = load_track("reinvent_base")
    racer.run_env(f"DR_EVAL_START_OFFSET={side}")
    settings = racer.settings().run.evaluation

    plans = [start_of(settings, way)[0] for way in (track, track.reversed())]

    assert all((plan.offset_m > 0.0) == (side == "left") for plan in plans)
    assert start_of(replace_offset(settings, "centre"), track)[0].offset_m == 0.0


def replace_offset(settings, word):
    return settings.replaced(eval_start_offset=word)
