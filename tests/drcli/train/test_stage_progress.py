"""In which stage a training is, and when the next one begins."""  # 001-25, 003-10, 003-11

from dataclasses import replace

import pytest

from drcli.config.loading import load_settings
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.records.stage import Stage, StageGoal, StageMark
from drcli.train.training_progress import StageProgress
from iterations import iteration_record


def counted(iteration: int, steps: int, episodes: int, elapsed_s: float) -> StageMark:
    return StageMark("", 1, 1, "", "", iteration, steps, episodes, elapsed_s)


BEGUN = counted(10, 1000, 200, 600.0)


@pytest.fixture
def stages(tmp_path):
    (tmp_path / "run.env").write_text("")
    (tmp_path / "system.env").write_text("")
    race = load_settings(tmp_path, environ={}).race

    def make(*goals: StageGoal) -> list[Stage]:
        return [
            Stage(f"s{n}", (race,), "", "r.py", f'{{"lr": 0.000{n}}}', goal)
            for n, goal in enumerate(goals, start=1)
        ]

    return make


def evaluated(iteration: int, *progress: float, laps=(), **changes):
    """A checkpoint with this evaluation, which drives 20 times as many laps again as well."""
    return iteration_record(
        iteration,
        evaluation_progress=list(progress),
        evaluation_lap_s=list(laps),
        confirmation_progress=list(progress) * 20,
        confirmation_lap_s=list(laps) * 20,
        **changes,
    )


@pytest.mark.parametrize(
    ("goal", "now", "said"),
    [
        (StageGoal(steps=500), counted(11, 1500, 210, 601.0), "500 steps are done"),
        (StageGoal(episodes=1), counted(11, 1001, 201, 601.0), "1 episode is done"),
        (StageGoal(iterations=2), counted(12, 1001, 201, 601.0), "2 iterations are done"),
        (StageGoal(minutes=1), counted(11, 1001, 201, 660.0), "1 minute has passed"),
    ],
)
def test_a_limit_counts_from_the_beginning_of_its_stage(stages, goal, now, said):
    progress = StageProgress(stages(goal, StageGoal()), None, BEGUN)

    assert progress.over([], BEGUN) is None
    assert progress.over([], now) == said


def test_all_targets_must_be_reached_by_evaluations_of_the_stage(stages):
    goal = StageGoal(laps=2, lap_time=12.0, evaluations=2)
    progress = StageProgress(stages(goal, StageGoal()), None, BEGUN)
    good = {"laps": (11.0, 12.0)}

    def over(*records):
        return progress.over(records, BEGUN)

    before = evaluated(9, 100.0, 100.0, **good)
    first, second = (evaluated(n, 100.0, 100.0, **good) for n in (10, 12))
    assert over(before, first) is None
    assert over(first, iteration_record(11), second) == (
        "checkpoint 12 drove 40 of 40 laps clean, median 11.50 s, slowest 12.00 s, 11.50 s on "
        "average, from starts that it had not driven before (goal of stage s1)"
    )
    assert over(first, replace(second, confirmation_progress=[], confirmation_lap_s=[])) is None
    assert over(first, evaluated(11, 100.0, 90.0, laps=(11.0,)), second) is None
    assert over(first, evaluated(12, 100.0, 100.0, laps=(11.0, 20.0))) is None


def test_progress_and_reward_can_be_goals(stages):
    progress = StageProgress(
        stages(StageGoal(progress=90, mean_reward=5.0), StageGoal()), None, BEGUN
    )
    good = [evaluated(n, 95.0, episodes=50, mean_reward=6.0) for n in (10, 11)]

    assert progress.over(good[:1], BEGUN) is None
    assert progress.over(good, BEGUN) == (
        "checkpoint 11 drove 0 of 20 laps clean, 95.0 % of the lap on average, from starts that it "
        "had not driven before (goal of stage s1) and the mean reward of 100 episodes is 6.0"
    )


def test_the_next_stage_begins_where_the_last_one_ended(stages):
    progress = StageProgress(stages(StageGoal(steps=1), StageGoal(laps=3)), None, BEGUN)

    mark = progress.begin_next(counted(11, 1100, 220, 700.0))

    assert (mark.name, mark.number, mark.iteration, mark.steps) == ("s2", 2, 11, 1100)
    assert progress.is_last
    assert progress.parameters(Hyperparameters()).lr == 0.0002
    assert StageProgress(stages(StageGoal(), StageGoal()), mark, BEGUN).name == "s2"


def test_goals_of_the_whole_training_judge_only_the_last_stage(stages):
    records = [iteration_record(n) for n in range(4)]
    two = stages(StageGoal(laps=1), StageGoal())
    first = StageProgress(two, StageMark("s1"), BEGUN)
    last = StageProgress(two, StageMark("s2", iteration=2), BEGUN)

    assert list(first.judged(records)) == []
    assert list(last.judged(records)) == records[2:]
    assert StageProgress([], None, BEGUN).judged(records) == records


def test_a_resumed_training_finds_its_stage_by_name(stages):
    changed = stages(StageGoal(laps=1), StageGoal(laps=2), StageGoal())
    progress = StageProgress(changed, StageMark("s2", number=1, count=2, iteration=7), BEGUN)

    assert progress.mark is not None
    assert (progress.mark.number, progress.mark.count, progress.mark.iteration) == (2, 3, 7)
    assert str(progress.mark) == "stage 2 of 3 (s2)"


def test_a_goal_reads_as_a_phrase():
    goal = StageGoal(laps=5, progress=99.5, evaluations=2, minutes=1)

    assert str(goal) == (
        "once all evaluation laps are completed, at least 5 and evaluations reach 99.5 % in 2 "
        "evaluations in a row or after 1 minute"
    )
    assert str(StageGoal()) == "with the training"


def test_a_teacher_reaches_no_mean_reward_of_a_stage(stages):
    progress = StageProgress(stages(StageGoal(mean_reward=5.0), StageGoal()), None, BEGUN)
    driven = {"episodes": 100, "mean_reward": 9.0}

    assert progress.over([iteration_record(10, phase="teacher", **driven)], BEGUN) is None
    assert progress.over([iteration_record(11, phase="ppo", **driven)], BEGUN) is not None
