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
    name = page.get_by_label("Name of the first model")
    name.fill("my model")
    page.get_by_role("button", name="Create the working folder").click()
    page.get_by_text("which is not allowed in a name in the bucket").wait_for()
    assert name.get_attribute("aria-invalid") == "true"
    assert page.get_by_text("run.env line").count() == 0
    name.fill("mine")
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
    help_of.get_by_text("From system.env.").wait_for()


TYPED = "# typed and not saved\n"


def editor(page):
    return page.get_by_label("Reward function", exact=True)


def by_link(page):
    page.get_by_role("link", name="Models").click()
    page.get_by_role("heading", name="Models").wait_for()
    page.get_by_role("link", name="New training").click()


def by_back(page):
    page.go_back()
    editor(page).wait_for(state="detached")
    page.go_forward()


def by_reload(page):
    page.reload()


def by_address(page):
    page.evaluate("location.hash = '#/nowhere'")
    page.get_by_role("heading", name="There is no such page").wait_for()
    page.evaluate("location.hash = '#/new'")


def by_skip_link(page):
    page.get_by_role("link", name="Skip to the content").press("Enter")


def by_another_site(page):
    back = page.url
    page.goto("about:blank")
    page.goto(back)


WAYS = (by_link, by_back, by_reload, by_address, by_another_site, by_skip_link)


def test_what_was_typed_is_there_again_however_the_page_was_left(served, visit, made):
    page = visit(served.url).page
    page.get_by_role("link", name="New training").click()
    step = page.locator("#step-reward")
    size = page.get_by_label("batch_size")
    for number, leave in enumerate(WAYS):
        typed = f"# typed {number} times\n{WRONG}"
        editor(page).fill(typed)
        size.fill(str(128 + number))

        leave(page)

        editor(page).wait_for()
        assert (leave, editor(page).input_value()) == (leave, typed)
        assert size.input_value() == str(128 + number)
    step.get_by_text("and not saved is shown again").wait_for()
    step.get_by_role("button", name="Save").click()
    step.get_by_text("Saved in custom_files/reward_function.py").wait_for()
    assert step.get_by_text("and not saved is shown again").count() == 0
    assert (made / "custom_files" / "reward_function.py").read_text() == typed


def test_goals_of_a_start_and_the_name_of_a_first_model_are_there_again(served, visit, folder):
    page = visit(f"{served.url}/#/new").page
    name = page.get_by_label("Name of the first model")
    name.fill("mine")
    page.reload()
    assert name.input_value() == "mine"
    write(plan_folder(folder, {}))
    (folder / "custom_files" / "reward_function.py").write_text(WRONG)
    page.reload()
    seed = page.get_by_label("Seed")
    seed.fill("12")
    page.reload()
    assert seed.input_value() == "12"


def test_what_was_discarded_does_not_come_again(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    editor(page).fill(TYPED + WRONG)
    page.reload()
    page.locator("#step-reward").get_by_role("button", name="Discard it").click()
    assert editor(page).input_value() == WRONG
    page.reload()
    editor(page).wait_for()
    assert editor(page).input_value() == WRONG


def test_two_tabs_keep_what_each_has_typed_and_offer_what_a_closed_one_has_left(
    served, visit, made
):
    first = visit(f"{served.url}/#/new").page
    editor(first).fill("# first\n" + WRONG)
    second = first.context.new_page()
    second.goto(f"{served.url}/#/new")
    editor(second).fill("# second\n" + WRONG)
    first.reload()
    assert editor(first).input_value().startswith("# first")
    second.close()
    first.reload()

    step = first.locator("#step-reward")
    step.get_by_text("from another tab that were not saved").wait_for()
    assert editor(first).input_value().startswith("# first")
    step.get_by_role("button", name="Show them").click()
    assert editor(first).input_value().startswith("# second")


def test_a_draft_of_a_file_that_has_changed_since_asks_which_counts(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    editor(page).fill("# mine\n" + WRONG)
    page.goto("about:blank")
    (made / "custom_files" / "reward_function.py").write_text("# theirs\n" + WRONG)
    page.goto(f"{served.url}/#/new")
    step = page.locator("#step-reward")
    step.get_by_role("button", name="Save").click()

    dialog = page.get_by_role("dialog")
    dialog.get_by_role("button", name="Take the one on the disk").click()
    step.get_by_text("Taken from the disk.").wait_for()
    assert editor(page).input_value().startswith("# theirs")


def test_a_question_does_not_stay_over_the_next_page(served, visit, made):
    page = visit(served.url).page
    page.get_by_role("link", name="New training").click()
    editor(page).fill(TYPED + WRONG)
    page.get_by_role("button", name="Use this template").click()
    page.get_by_role("dialog").wait_for()

    page.go_back()

    page.get_by_role("heading", name="Live").wait_for()
    assert page.get_by_role("dialog").count() == 0


def test_wrong_fields_and_actions_are_marked(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    speed = page.get_by_label("Speed of action 1")
    speed.fill("fast")
    rate = page.get_by_label("lr", exact=True)
    rate.fill("5")

    page.locator("[data-key=lr] [aria-invalid=true]").wait_for()
    page.locator("[data-key='action_space[1].speed'][aria-invalid=true]").wait_for()
    for control in (rate, speed):
        color = control.evaluate("each => getComputedStyle(each).borderTopColor")
        usual = page.get_by_label("batch_size").evaluate("e => getComputedStyle(e).borderTopColor")
        assert color != usual


def test_what_is_wrong_in_the_files_is_marked_in_its_field(served, visit, made):
    with (made / "run.env").open("a") as file:
        file.write("DR_TRAIN_WORLDS=zoo:many\n")
    metadata = made / "custom_files" / "model_metadata.json"
    metadata.write_text(metadata.read_text().replace("COMPACT_CONVOLUTIONAL_NETWORK", "COMPACT"))
    page = visit(f"{served.url}/#/new").page
    page.get_by_label("Steering granularity").fill("0")
    page.get_by_role("button", name="Generate").click()

    for label in ("Further tracks that are trained", "Network", "Steering granularity"):
        field = page.get_by_label(label)
        field.and_(page.locator("[aria-invalid=true]")).wait_for()
    page.goto(f"{served.url}/#/settings?name=DR_TRAIN_WORLDS")
    field = page.get_by_label("DR_TRAIN_WORLDS")
    field.and_(page.locator("[aria-invalid=true]")).wait_for()
    assert page.locator(".problems").get_by_text("zoo:many").count() == 1


def test_a_line_that_stops_every_page_is_mended_in_the_page(served, visit, made):
    run_env = made / "run.env"
    run_env.write_text(run_env.read_text() + "DR_WORKERS several\n")
    visited = visit(f"{served.url}/#/new")
    page = visited.page
    page.get_by_role("link", name="Open the settings").click()
    line = page.get_by_label("Write run.env line")
    line.fill("DR_WORKERS many")
    page.get_by_role("button", name="Replace the line").click()
    page.locator("main").get_by_text("DR_WORKERS many is not").first.wait_for()
    line.fill("# later")
    page.get_by_role("button", name="Replace the line").click()
    line.wait_for(state="detached")
    page.get_by_role("link", name="New training").click()
    page.locator("#step-model").wait_for()

    assert run_env.read_text().endswith("\n# later\n")
    # The browser itself reports what was refused meanwhile.
    visited.problems[:] = [each for each in visited.problems if "422" not in each]


@pytest.mark.parametrize("name", ["hyperparameters", "model_metadata"])
def test_a_file_that_is_not_json_begins_again_with_the_shipped_one(served, visit, made, name):
    (made / "custom_files" / f"{name}.json").write_text("nothing")
    page = visit(f"{served.url}/#/new").page
    wrong = page.locator(".step-problems").get_by_text("is not valid JSON")
    wrong.first.wait_for()

    page.get_by_role("button", name="begin again with the shipped file").click()

    wrong.first.wait_for(state="detached")


def test_what_is_typed_while_a_file_is_saved_stays(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    step = page.locator("#step-reward")
    editor(page).fill("# first\n" + WRONG)
    page.evaluate(
        """() => {
            const send = window.fetch;
            window.fetch = async (path, options) => {
                if (options?.method === "PUT") await new Promise((go) => {
                    window.go = go;
                    document.body.dataset.waits = "";
                });
                return send(path, options);
            };
        }"""
    )
    step.get_by_role("button", name="Save").click()
    page.locator("body[data-waits]").wait_for()
    editor(page).fill("# second\n" + WRONG)
    page.evaluate("window.go()")

    step.get_by_text("Not saved yet").wait_for()
    assert editor(page).input_value().startswith("# second")
    file = made / "custom_files" / "reward_function.py"
    assert file.read_text().startswith("# first")


def test_two_steps_that_are_one_file_are_saved_after_each_other(served, visit, made):
    page = visit(f"{served.url}/#/new").page
    sensors, actions = page.locator("#step-sensors"), page.locator("#step-actions")
    sensors.get_by_label("Network").select_option("DEEP_CONVOLUTIONAL_NETWORK_SHALLOW")
    actions.get_by_label("Speed of action 1").fill("0.77")

    for step in (sensors, actions):
        step.get_by_role("button", name="Save").click()
        step.get_by_text("Saved in custom_files/model_metadata.json").wait_for()

    assert page.get_by_role("dialog").count() == 0
    text = (made / "custom_files" / "model_metadata.json").read_text()
    assert "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW" in text
    assert "0.77" in text
