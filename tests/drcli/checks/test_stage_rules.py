"""Stages change the settings of every worker, and each problem has its line."""  # 001-25, 003-11

import pytest

from drcli.checks.stage_rules import review_stages
from drcli.config.loading import load_settings
from drcli.config.track_names import track_problems

ONE = """\
stages:
  - name: wide
    world: bean
    settings:
      DR_TRAIN_REVERSE_DIRECTION: yes
      DR_SIM_LATENCY: 0.03
"""


@pytest.fixture
def review(tmp_path):
    """Reviews a curriculum in a folder whose second worker has a file of its own."""
    (tmp_path / "system.env").write_text("DR_WORKERS=2\n")
    (tmp_path / "run.env").write_text(
        "DR_CURRICULUM_FILE=stages.yaml\nDR_TRAIN_MULTI_CONFIG=True\nDR_WORLD_NAME=willow\n"
    )
    (tmp_path / "worker-2.env").write_text("DR_WORLD_NAME=paddle\nDR_RACE_TYPE=OBJECT_AVOIDANCE\n")

    def run(text: str):
        (tmp_path / "stages.yaml").write_text(text)
        return review_stages(load_settings(tmp_path, environ={}), {})

    return run


def test_a_stage_changes_all_workers_and_leaves_the_rest_to_their_files(review):
    [stage] = review(ONE).stages
    first, second = stage.settings.races

    assert (first.world_name, second.world_name) == ("bean", "bean")
    assert (first.race_type, second.race_type) == ("TIME_TRIAL", "OBJECT_AVOIDANCE")
    assert first.train_reverse_direction
    assert second.train_reverse_direction
    assert second.source("DR_WORLD_NAME").endswith("stages.yaml line 3")
    assert second.source("DR_RACE_TYPE").endswith("worker-2.env line 2")


@pytest.mark.parametrize(
    ("before", "after", "rule", "line", "said"),
    [
        ("yes", "maybe", "V-12", 5, "DR_TRAIN_REVERSE_DIRECTION=maybe is neither"),
        ("world: bean", "world: my track", "V-05", 3, "DR_WORLD_NAME=my track cannot be"),
        ("world: bean", "race_type: RACE", "V-07", 3, "DR_RACE_TYPE=RACE is not one of"),
        ("DR_SIM_LATENCY", "DR_SIM_LATENCI", "V-60", 6, "DR_SIM_LATENCI is not a setting"),
        ("DR_SIM_LATENCY", "DR_WORLD_NAME", "V-60", 6, "DR_WORLD_NAME is given twice"),
        ("world: bean", "reward_function: x.py", "V-60", 3, "there is no such file"),
    ],
)
def test_a_problem_has_the_rule_of_its_setting_and_the_line_of_the_stage(
    review, before, after, rule, line, said
):
    problem = review(ONE.replace(before, after)).problems[0]

    assert (problem.rule, problem.line) == (rule, line)
    assert problem.file.endswith("stages.yaml")
    assert said in problem.message
    assert problem.remedy


def test_what_is_right_in_a_wrong_stage_can_still_be_checked(review):
    """Its track, which `validate` looks for, and the folder's hyperparameters."""
    text = ONE.replace("world: bean", "world: nowhere\n    hyperparameters: {lr: 2}")

    reviewed = review(text.replace("yes", "maybe"))

    assert [problem.line for problem in reviewed.problems] == [6, 4]
    [stage] = reviewed.stages
    assert [problem.message for problem in track_problems(stage.settings.races)] == [
        "DR_WORLD_NAME=nowhere is not a known track."
    ]


def test_without_the_setting_there_are_no_stages(tmp_path):
    (tmp_path / "run.env").write_text("")
    (tmp_path / "system.env").write_text("")

    assert review_stages(load_settings(tmp_path, environ={}), {}).stages == ()
