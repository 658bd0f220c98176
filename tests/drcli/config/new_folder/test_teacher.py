"""`dr init --teacher` writes the key into the new folder's hyperparameters.json."""

import json

import pytest

from drcli.base.errors import SettingsError
from drcli.cli.commands import init
from drcli.config.new_folder import plan_folder
from drcli.config.presets import preset_of
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.training_method import plan_with_method


def parameters_of(plan) -> bytes:
    [data] = (f.data for f in plan.files if f.name.endswith("hyperparameters.json"))
    return data


@pytest.mark.parametrize("preset", [None, "virtual", "physical", "student-league"])
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


def test_new_folders_begin_as_the_one_constant_says(tmp_path, monkeypatch):
    plan = plan_folder(tmp_path, {}, None)
    sac = plan_folder(tmp_path, {}, preset_of("sac"))
    assert init._with_teacher(plan, None, is_own=True) is plan

    monkeypatch.setattr(init, "TEACHER", True)

    taught = init._with_teacher(plan, None, is_own=True)
    assert b'"training_method": "teacher"' in parameters_of(taught)
    assert init._with_teacher(sac, None, is_own=True) is sac
    assert init._with_teacher(plan, None, is_own=False) is plan


@pytest.mark.parametrize(("answer", "wanted"), [("yes", True), ("no", False)])
def test_the_question_is_answered_with_yes_or_no(answer, wanted):
    def ask(question, default, choices):
        assert (default, choices) == ("no", ("yes", "no"))
        return answer

    assert init.wants_teacher(ask) is wanted
