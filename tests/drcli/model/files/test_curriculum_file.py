"""curriculum.yaml: what is read, and what is wrong with it, with its line."""  # 001-25, 003-11

import pytest

from drcli.base.errors import ProblemsError
from drcli.config.presets import model_file
from drcli.model.files.curriculum_file import MOST_STAGES, CurriculumFile
from drcli.records.stage import StageGoal

GOOD = """\
stages:
  - name: wide
    world: bean
    goal: {laps: 5, minutes: 20}
  - name: 2
    race_type: HEAD_TO_BOT
    reward_function: bots.py
    hyperparameters: {lr: 0.0003}
    settings: {DR_H2B_NUMBER_OF_BOT_CARS: 3, DR_H2B_IS_LANE_CHANGE: true}
"""


def refused(text: str | bytes) -> ProblemsError:
    data = text if isinstance(text, bytes) else text.encode()
    with pytest.raises(ProblemsError) as error:
        CurriculumFile.from_bytes(data)
    return error.value


def test_stages_are_read_with_what_they_change():
    wide, bots = CurriculumFile.from_bytes(GOOD.encode()).stages

    assert wide.stage_goal == StageGoal(laps=5, minutes=20)
    assert (bots.name, bots.reward_function) == ("2", "bots.py")
    assert bots.hyperparameters == {"lr": 0.0003}
    assert bots.settings == {"DR_H2B_NUMBER_OF_BOT_CARS": "3", "DR_H2B_IS_LANE_CHANGE": "True"}
    assert bots.stage_goal.empty


def test_the_shipped_example_goes_from_a_wide_track_to_bots():
    stages = CurriculumFile.from_bytes(model_file("curriculum.yaml").read_bytes()).stages

    assert [stage.name for stage in stages] == ["wide", "base", "hard", "bots"]
    assert stages[1].world == "reinvent_base"
    assert stages[-1].race_type == "HEAD_TO_BOT"
    # The shipped reward function pays for the middle of the road, where a bot cannot be passed.
    assert stages[-1].reward_function == "overtake.py"


@pytest.mark.parametrize(
    ("before", "after", "line", "said"),
    [
        ("laps: 5", "laps: 0", 4, "stages[0].goal.laps=0 is below 1"),
        ("laps: 5", "laps: many", 4, "stages[0].goal.laps"),
        ("minutes: 20", "minutes: -1", 4, "minutes=-1 is not above 0"),
        ("minutes: 20", "minutes: .nan", 4, ".nan is not a number"),
        ("name: 2", "name: wide", 5, "is also the name of stage 1"),
        ("name: 2", "name: ../x", 5, "cannot be the name of a stage"),
        ("world: bean", "wordl: bean", 3, "stages[0].wordl is not a key"),
        ("laps: 5", "lap: 5", 4, "stages[0].goal.lap is not a key"),
        ("world: bean", "action_space: []", 3, "cannot change from stage to stage"),
        ("{laps: 5, minutes: 20}", "{}", 4, "has no goal, so the next one never begins"),
        ("{lr: 0.0003}", "[1]", 8, "is neither hyperparameters nor the name of a file"),
        ("world: bean", "world: bean\n    world: oval", 4, "The key world occurs twice"),
        ("world: bean", "world: !!binary aGk=", 3, "has the type"),
        ("goal: {laps", "goal: {laps: [", 4, "is not valid YAML"),
    ],
)
def test_a_problem_names_its_line(before, after, line, said):
    problem = refused(GOOD.replace(before, after, 1)).problems[0]

    assert said in problem.message
    assert problem.line == line
    assert problem.remedy


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"", "is empty"),
        (b"- a\n- b\n", "instead of the key stages"),
        (b"stages: 3\n", "is not a list"),
        (b"stages: []\n", "is empty"),
        (b"{}\n", "stages is missing"),
        (b"stages:\n  - \xff\n", "is not UTF-8"),
        (b"stages: &a [*a]\n", "refers to itself"),
        (b"stages:\n  - 4\n", "is not an object"),
    ],
)
def test_a_damaged_file_is_told_in_a_sentence(text, said):
    assert said in str(refused(text))


def test_anchors_can_be_used_but_not_to_fill_the_memory():
    shared = "stages:\n- &a {name: a, goal: {laps: 3}}\n- {<<: *a, name: b}\n"
    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{after}: &{after} [{','.join([f'*{before}'] * 9)}]\n"
        for before, after in zip("abcdefg", "bcdefgh", strict=True)
    )

    assert [s.goal.laps for s in CurriculumFile.from_bytes(shared.encode()).stages] == [3, 3]
    assert "nested too deeply" in str(refused(bomb))


def test_too_many_stages_are_a_mistake():
    entries = "".join(f"- {{name: s{n}, goal: {{laps: 1}}}}\n" for n in range(MOST_STAGES + 1))

    assert f"at most {MOST_STAGES} are allowed" in str(refused(f"stages:\n{entries}"))


def test_a_date_stays_a_text():
    text = GOOD.replace("world: bean", "world: 2024-05-01")

    assert CurriculumFile.from_bytes(text.encode()).stages[0].world == "2024-05-01"
