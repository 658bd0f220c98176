"""A start with stages: what is checked first, what is kept with the model, what a resume does."""

import json

import pytest

from drcli.base.errors import SettingsError
from drcli.model import keys
from drcli.records.checkpoint import Counters
from drcli.records.stage import FrozenCurriculum, StageMark

TWO = """\
stages:
  - name: wide
    world: bean
    goal: {laps: 5, minutes: 20}
  - name: bots
    race_type: HEAD_TO_BOT
    reward_function: bots.py
    hyperparameters: {lr: 0.0002}
    settings: {DR_H2B_NUMBER_OF_BOT_CARS: 2}
    goal: {laps: 3}
"""


@pytest.fixture
def staged(racer):
    """A racer with a curriculum."""
    racer.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=model-1",
        "DR_WORLD_NAME=reinvent_base",
        "DR_CURRICULUM_FILE=curriculum.yaml",
    )
    racer.curriculum = racer.folder / "curriculum.yaml"
    racer.curriculum.write_text(TWO)
    (racer.folder / "bots.py").write_text("def reward_function(p): return 2.0")
    return racer


def in_stage(racer, name: str, number: int = 7) -> None:
    """Let the model's newest checkpoint belong to a stage."""
    racer.store("model-1").save(
        number, 100 * number, b"weights", counters=Counters(stage=StageMark(name, iteration=number))
    )


def test_each_stage_has_its_own_race_reward_and_hyperparameters(staged):
    staged.hyperparameters(lr=0.001, batch_size=128)

    plan = staged.start()

    wide, bots = plan.job.stages
    assert (wide.race().world_name, wide.race().race_type) == ("bean", "TIME_TRIAL")
    assert (bots.race().world_name, bots.race().race_type) == ("reinvent_base", "HEAD_TO_BOT")
    assert bots.race().h2b_number_of_bot_cars == 2
    assert bots.reward == "def reward_function(p): return 2.0"
    assert wide.reward == "def reward_function(p): ..."
    parameters = json.loads(bots.hyperparameters)
    assert (parameters["lr"], parameters["batch_size"]) == (0.0002, 128)
    assert plan.job.config.race().world_name == "bean"
    assert "with the last of 2 stages, bots: once all evaluation laps" in plan.ends


def test_another_machine_goes_on_without_the_files(staged):
    first = staged.start()
    in_stage(staged, "bots")
    for name in ("curriculum.yaml", "bots.py"):
        (staged.folder / name).unlink()

    resumed = staged.start(resume=True)

    assert [stage.reward for stage in resumed.job.stages] == [
        stage.reward for stage in first.job.stages
    ]
    assert resumed.job.config.race().race_type == "HEAD_TO_BOT"


def test_a_file_that_was_changed_meanwhile_counts_and_is_told(staged):
    staged.start()
    in_stage(staged, "bots")
    staged.curriculum.write_text(TWO.replace("laps: 3", "laps: 4").replace("bean", "willow"))

    resumed = staged.start(resume=True)

    assert resumed.job.stages[1].goal.laps == 4
    assert any("curriculum.yaml changed since the last start" in w for w in resumed.warnings)


def test_the_stage_of_the_model_must_still_exist(staged):
    staged.start()
    in_stage(staged, "bots")
    staged.curriculum.write_text(TWO.replace("name: bots", "name: cars"))

    with pytest.raises(SettingsError, match="no stage bots, in which the training") as refused:
        staged.start(resume=True)

    assert "Give one of the stages the name bots again" in refused.value.remedy


def test_a_training_can_go_on_without_stages_and_with_them_again(staged):
    staged.start()
    in_stage(staged, "bots")
    staged.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1")

    without = staged.start(resume=True)

    assert without.job.stages == ()
    assert any("DR_CURRICULUM_FILE is empty" in warning for warning in without.warnings)


def test_the_model_keeps_the_curriculum_with_all_its_files(staged):
    staged.start()

    kept = FrozenCurriculum.decode(staged.bucket.get(keys.curriculum("model-1")))

    assert kept.text == TWO
    assert dict(kept.files) == {"bots.py": "def reward_function(p): return 2.0"}


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("HEAD_TO_BOT", "HEAD_TO_MODEL", "for evaluations only"),
        ("HEAD_TO_BOT", "DRAG", "DR_RACE_TYPE=DRAG is not one of"),
        ("{lr: 0.0002}", "{lr: 2}", "lr=2 is above"),
        ("{lr: 0.0002}", "{learning: 2}", "learning=2 is not a hyperparameter"),
        ("{lr: 0.0002}", "{stack_size: 2}", "its weights only fit that"),
        ("{lr: 0.0002}", "{critic: state}", "its weights only fit that"),
        ("{lr: 0.0002}", "{term_cond_max_episodes: 5}", "counts the iterations of the whole"),
        ("{lr: 0.0002}", "missing.json", "there is no such file"),
        ("bots.py", "other.py", "there is no such file"),
        ("DR_H2B_NUMBER_OF_BOT_CARS: 2", "DR_WORKERS: 2", "holds for the whole training"),
        ("DR_H2B_NUMBER_OF_BOT_CARS: 2", "DR_H2B_NUMBER_OF_BOTS: 2", "is not a setting"),
        ("DR_H2B_NUMBER_OF_BOT_CARS: 2", "DR_H2B_NUMBER_OF_BOT_CARS: x", "not a whole number"),
    ],
)
def test_nothing_starts_with_a_stage_that_is_wrong(staged, before, after, said):
    staged.curriculum.write_text(TWO.replace(before, after, 1))
    staged.hyperparameters()

    with pytest.raises(SettingsError, match=said):
        staged.start()

    assert list(staged.bucket.list("")) == []


def test_a_start_names_everything_that_is_wrong_in_all_stages_at_once(staged):
    staged.curriculum.write_text(
        TWO.replace("laps: 5, minutes: 20}", "laps: 5}\n    hyperparameters: {lr: 2}")
        .replace("race_type: HEAD_TO_BOT", "world: my track")
        .replace("{lr: 0.0002}", "bots.json")
    )
    (staged.folder / "bots.json").write_text('{"batch_size": -7}')
    staged.hyperparameters()

    with pytest.raises(SettingsError) as refused:
        staged.start()

    for said in ("lr=2 is above", "DR_WORLD_NAME=my track cannot be", "batch_size=-7 is"):
        assert said in str(refused.value)
    assert list(staged.bucket.list("")) == []


def test_a_curriculum_that_does_not_exist_is_told_with_the_setting(staged):
    staged.curriculum.unlink()

    with pytest.raises(
        SettingsError, match=r"run\.env line 3: DR_CURRICULUM_FILE=curriculum\.yaml"
    ):
        staged.start()


def test_a_reward_function_that_no_stage_uses_is_checked_as_it_becomes_the_models(staged):
    staged.curriculum.write_text(
        TWO.replace("world: bean", "world: bean\n    reward_function: bots.py", 1)
    )
    own = staged.folder / "custom_files" / "reward_function.py"
    own.write_bytes("# é\ndef reward_function(p): return 1.0".encode("latin-1"))

    with pytest.raises(SettingsError, match=r"reward_function\.py.*UTF-8"):
        staged.start()

    assert list(staged.bucket.list("")) == []
