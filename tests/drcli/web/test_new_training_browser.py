"""New training and settings in a browser."""

from pathlib import Path

import pytest

from drcli.config.new_folder import plan_folder, write

WRONG = "def reward_function(params):\n    return 1.0 +\n"


@pytest.fixture
def folder(empty_folder: Path) -> Path:
    return empty_folder


@pytest.fixture
def made(folder: Path) -> Path:
    """A working folder whose reward function is not even tried, which would take long."""
    write(plan_folder(folder, {}))
    (folder / "custom_files" / "reward_function.py").write_text(WRONG)
    return folder


def test_an_empty_folder_becomes_a_working_folder_and_the_page_goes_on(served, visit, folder):
    page = visit(f"{served.url}/#/new", width=360).page
    page.get_by_label("Name of the first model").fill("mine")
    page.get_by_role("button", name="Create the working folder").click()

    page.wait_for_selector("#step-model")

    assert "DR_LOCAL_S3_MODEL_PREFIX=mine" in (folder / "run.env").read_text()
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    unnamed = "[...document.querySelectorAll('main input, main select, main textarea')]"
    unnamed += ".filter(each => !each.labels.length && !each.ariaLabel).length"
    assert page.evaluate(unnamed) == 0


def test_steps_are_checked_while_they_are_edited_and_saved_by_themselves(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    model, race, actions = (page.locator(f"#step-{name}") for name in ("model", "race", "actions"))
    name = model.get_by_label("Name of the model")
    name.fill("not good")
    model.get_by_text("which is not allowed in a name in the bucket").wait_for()
    name.fill("good")
    model.get_by_role("button", name="Save").click()
    model.get_by_text("Saved in run.env").wait_for()
    page.get_by_label("Search tracks").fill("willow")
    race.get_by_role("radio").check()
    assert race.get_by_label("Train on willow too").is_disabled()
    further = race.get_by_label("Further tracks that are trained")
    further.fill("zoo:64")
    page.get_by_label("Search tracks").fill("bean")
    race.get_by_label("Train on bean too").check()
    assert further.input_value() == "zoo:64, bean"
    further.fill("bean")
    race.get_by_label("Train on bean too").uncheck()
    further.fill("zoo:64,bean")
    assert race.get_by_label("Train on bean too").is_checked()
    race.get_by_role("button", name="Save").click()
    race.get_by_text("Saved in run.env").wait_for()
    actions.get_by_label("Steering granularity").fill("3")
    actions.get_by_role("button", name="Generate").click()
    actions.get_by_text("6 actions, up to").wait_for()
    actions.get_by_label("Speed of action 5").fill("fast")
    actions.get_by_text('action_space[5].speed="fast" is not a number').wait_for()
    actions.get_by_label("Speed of action 5").fill("0.75")
    actions.get_by_role("button", name="Save").click()
    actions.get_by_text("Saved in custom_files/model_metadata.json").wait_for()

    run = (made / "run.env").read_text()
    assert "DR_LOCAL_S3_MODEL_PREFIX=good" in run
    assert "DR_WORLD_NAME=willow" in run
    assert "DR_TRAIN_WORLDS=zoo:64,bean" in run
    assert '"speed": 0.75' in (made / "custom_files" / "model_metadata.json").read_text()


def test_the_editor_marks_lines_and_is_left_by_the_keyboard(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    editor = page.get_by_label("Reward function", exact=True)
    page.locator("#step-reward .problems .link").click()

    assert page.locator(".code-line.error").inner_text() == "2"
    assert editor.evaluate("area => area.selectionStart") == len(WRONG.split("\n")[0]) + 1
    page.keyboard.press("Control+Home")
    page.keyboard.press("Tab")
    assert editor.input_value().startswith("    def")
    page.keyboard.press("Shift+Tab")
    assert editor.input_value() == WRONG
    page.keyboard.press("Escape")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.tagName") != "TEXTAREA"


def test_both_versions_are_shown_when_a_file_has_changed_on_the_disk(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    step = page.locator("#step-reward")
    step.get_by_label("Reward function", exact=True).fill("# mine\n" + WRONG)
    (made / "custom_files" / "reward_function.py").write_text("# theirs\n" + WRONG)
    step.get_by_role("button", name="Save").click()
    dialog = page.get_by_role("dialog")

    assert "# mine" in dialog.inner_text()
    assert "# theirs" in dialog.inner_text()
    dialog.get_by_role("button", name="Write mine").click()
    step.get_by_text("Saved in custom_files/reward_function.py").wait_for()
    assert (made / "custom_files" / "reward_function.py").read_text().startswith("# mine")


def test_a_setting_is_found_changed_and_saved(served, visit, made):
    page = visit(f"{served.url}/#/settings").page
    page.get_by_label("Search settings").fill("stall")
    field = page.get_by_label("DR_STALL_MINUTES")
    field.fill("soon")
    page.get_by_text("is not a whole number").first.wait_for()
    field.fill("5")
    page.get_by_role("button", name="Save").click()
    page.get_by_text("Saved in system.env").wait_for()

    assert "DR_STALL_MINUTES=5" in (made / "system.env").read_text()
    help_of = page.locator("[data-key=DR_STALL_MINUTES] .help")
    help_of.get_by_text("From system.env line").wait_for()
