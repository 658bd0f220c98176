"""`dr init --teacher` writes the key into the new folder's hyperparameters.json."""

import json

import pytest

from drcli.base.errors import SettingsError
from drcli.cli.commands import init
from drcli.config.new_folder import plan_folder
from drcli.config.presets import preset_of
from drcli.model.files.hyperparameters import Hyperparameters, plan_with_method


def parameters_of(plan) -> bytes:
    [data] = (f.data for f in plan.files if f.name.endswith("hyperparameters.json"))
    return data


@pytest.mark.parametrize("preset", [None, "virtual", "unseen", "physical", "student-league"])
def test_the_key_gets_a_line_of_its_own_and_all_others_stay(tmp_path, preset):
    plan = plan_folder(tmp_path, {}, None if preset is None else preset_of(preset))
    before = parameters_of(plan)

    after = parameters_of(plan_with_method(plan, teacher=True))

    assert Hyperparameters.from_bytes(after).training_method == "teacher"
    assert after == before.replace(b"{\n", b'{\n  "training_method": "teacher",\n', 1)
    off = parameters_of(plan_with_method(plan, teacher=False))
    assert json.loads(off)["training_method"] == "camera"


def test_a_preset_for_sac_has_no_teacher(tmp_path):
    plan = plan_folder(tmp_path, {}, preset_of("sac"))

    with pytest.raises(SettingsError, match="training_algorithm=sac"):
        plan_with_method(plan, teacher=True)


@pytest.mark.parametrize(
    ("options", "method"),
    [
        ([], None),
        (["--preset", "physical"], None),
        (["--preset", "virtual"], "teacher"),
        (["--preset", "unseen"], "teacher"),
        (["--preset", "virtual", "--race-type", "OBJECT_AVOIDANCE"], None),
        (["--preset", "virtual", "--no-teacher"], "camera"),
        (["--teacher"], "teacher"),
    ],
)
def test_models_of_the_fast_preset_have_a_teacher(dr, empty, options, method):
    assert dr("init", "--force", *options) == 0

    written = json.loads((empty / "custom_files/hyperparameters.json").read_bytes())
    assert written.get("training_method") == method


def test_an_experiment_has_no_teacher_unless_it_is_asked_for(dr, empty):
    dr("init", "--force", "--race-type", "OBJECT_AVOIDANCE")

    dr("init", "--force", "--experiment", "quick", "--preset", "virtual")

    written = (empty / "experiments/quick/custom_files/hyperparameters.json").read_text()
    assert "training_method" not in written


@pytest.mark.parametrize("usually", ["yes", "no"])
@pytest.mark.parametrize(("answer", "wanted"), [("yes", True), ("no", False)])
def test_the_question_is_answered_with_yes_or_no(answer, wanted, usually):
    def ask(question, default, choices):
        assert (default, choices) == (usually, ("yes", "no"))
        return answer

    assert init.wants_teacher(ask, usually=usually == "yes") is wanted
