"""Under which conditions the episodes of a training with a teacher are driven."""

import json
from dataclasses import replace

import pytest

from drcli.drive.build_race import actions_of
from drcli.drive.driving import Racer
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.records.stage import PhaseMark, RangesMark
from drcli.train import training_simulation
from drcli.train.training_simulation import TrainingSimulation
from drsim.car.conditions import NOMINAL
from drsim.episode.reward import centre_line_reward
from small_policies import metadata_json, small_metadata, small_network


@pytest.fixture
def plans(racer, tmp_path, monkeypatch):
    """The episodes 0 to 19 and 3 of an evaluation, in a phase, with lines of run.env.

    `share` is that of the ranges, as a checkpoint tells it.
    """
    monkeypatch.setattr(training_simulation, "load_reward", lambda *_: centre_line_reward)

    def plans(phase, *lines, share=None):
        racer.model_metadata(**json.loads(metadata_json()))
        racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", *lines)
        metadata = small_metadata()
        simulation = TrainingSimulation(
            Job(racer.settings().run, "t", 3, None, tmp_path, launcher_pid=1),
            ModelStore(racer.bucket, "model-1"),
            Design(metadata, Hyperparameters.from_bytes(b"{}", "h.json"), "m.json", "h.json"),
            [Racer(small_network(metadata), actions_of(metadata))],
            None,
            worker=0,
            divisor=1,
            on_reward_error=lambda error, car: 0.0,
        )
        simulation.enter_phase(None if phase is None else PhaseMark(phase, 0, 0))
        simulation.enter_ranges(None if share is None else RangesMark(share))
        made = simulation.plans(range(20), 3)
        simulation.close()
        return [plan.conditions for plan in made[:20]], [plan.conditions for plan in made[20:]]

    return plans


def test_a_student_meets_mild_disturbances_in_half_of_its_episodes(plans):
    driven, evaluated = plans("distillation")

    assert 4 <= driven.count(NOMINAL) <= 16
    assert evaluated == [NOMINAL] * 3
    assert plans("teacher")[0] == [NOMINAL] * 20


def test_the_gray_overlay_of_the_car_adds_to_them_and_changes_nothing_else(plans):
    driven, evaluated = plans("distillation")
    overlaid, evaluated_so = plans("distillation", "DR_SIM_GRAY_OVERLAY=1")

    assert overlaid == [replace(each, gray_overlay=True) for each in driven]
    assert evaluated_so == [replace(each, gray_overlay=True) for each in evaluated]


def test_other_settings_take_the_place_of_mild_disturbances(plans):
    assert plans("distillation", "DR_SIM_LATENCY=0.05") == ([None] * 20, [None] * 3)


GROWS = "DR_SIM_GROW=True", "DR_SIM_BRIGHTNESS=0.4", "DR_SIM_LATENCY=0.05"


@pytest.mark.parametrize("phase", [None, "distillation"])
def test_training_episodes_draw_from_a_share_of_the_ranges_and_evaluations_from_all(plans, phase):
    driven, evaluated = plans(phase, *GROWS, share=0.25)
    wider, evaluated_so = plans(phase, *GROWS, share=0.5)

    changes = [each.brightness - 1.0 for each in driven]
    assert 0.05 < max(map(abs, changes)) <= 0.1
    assert [each.brightness - 1.0 for each in wider] == pytest.approx([2.0 * c for c in changes])
    assert {each.latency_s for each in driven} == {0.05}, "it is no range"
    assert evaluated == evaluated_so
    assert max(abs(each.brightness - 1.0) for each in evaluated) > 0.1


def test_episodes_with_the_full_ranges_are_drawn_as_without_growth(plans):
    nothing = [None] * 20, [None] * 3

    assert plans(None, *GROWS, share=1.0) == nothing
    assert plans(None, *GROWS[1:], share=0.25) == nothing, "a worker without DR_SIM_GROW"


def test_the_gray_overlay_of_a_student_grows_too(plans):
    lines = "DR_SIM_GROW=True", "DR_SIM_GRAY_OVERLAY=1"

    driven, evaluated = plans("distillation", *lines, share=0.25)

    assert 0 < sum(each.gray_overlay for each in driven) < 15
    assert all(each.gray_overlay for each in evaluated)
