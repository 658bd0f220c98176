"""The pages of models in a browser, by mouse and by keyboard."""

import pytest

from stored_models import STAMP, StoredModels

PREFIX = "team/model-1"


@pytest.fixture
def models(working_folder):
    stored = StoredModels(working_folder)
    stored.model(PREFIX)
    clean = {"off_track_count": 0, "reset_count": 0}
    stored.evaluation(PREFIX, lap_ms=(12_345, 61_000), **clean)
    stored.evaluation(PREFIX, "20260102030500", lap_ms=(11_000,), **clean)
    return stored


def test_an_empty_bucket_says_what_to_do_next(served, visit, working_folder):
    StoredModels(working_folder)

    page = visit(f"{served.url}/#/models").page

    page.get_by_text("There is no model in s3://bucket yet").wait_for()
    assert page.get_by_role("link", name="Start a training").is_visible()


def test_a_new_model_appears_without_reload_and_is_found(served, visit, models):
    page = visit(f"{served.url}/#/models", width=360, theme="dark").page
    page.get_by_role("link", name=PREFIX).wait_for()

    models.model("another")

    page.get_by_role("link", name="another").wait_for()
    page.get_by_label("Search").fill("reinvent nothing")
    page.get_by_text("No model fits the search").wait_for()
    page.get_by_label("Search").fill("anoth")
    page.get_by_role("link", name=PREFIX).wait_for(state="detached")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_a_model_is_read_by_keyboard_alone(served, visit, models):
    page = visit(f"{served.url}/#/models").page
    page.get_by_role("link", name=PREFIX).focus()
    page.keyboard.press("Enter")
    page.get_by_role("tab", name="Overview").focus()
    page.keyboard.press("ArrowRight")
    page.get_by_role("cell", name="1 of 2").first.wait_for()  # laps of the first checkpoint
    page.keyboard.press("ArrowRight")
    page.get_by_role("cell", name="11.00 s").wait_for()
    assert "tab=evaluations" in page.url
    page.go_back()
    page.get_by_role("cell", name="1 of 2").first.wait_for()
    page.go_forward()

    page.get_by_label("Compare with").select_option(STAMP)

    page.get_by_role("cell", name="−1.345 s").wait_for()
    models.evaluation(PREFIX, "20260102030600", lap_ms=(10_000,))
    page.get_by_role("cell", name="10.00 s").first.wait_for()  # by itself


def test_a_model_is_deleted_only_when_its_name_was_typed(served, visit, models):
    page = visit(f"{served.url}/#/model?prefix={PREFIX}").page
    page.get_by_role("button", name="Delete").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_role("textbox").fill("team/model")
    assert dialog.get_by_role("button", name="Delete").is_disabled()
    dialog.get_by_role("textbox").fill(PREFIX)
    assert dialog.get_by_role("button", name="Delete").is_enabled()
    page.keyboard.press("Escape")
    dialog.wait_for(state="detached")


def test_what_is_no_model_has_a_way_back(served, visit, models):
    visited = visit(f"{served.url}/#/model?prefix=no/such")
    visited.page.get_by_text("There is no model no/such").wait_for()
    visited.page.get_by_role("link", name="All models").click()
    visited.page.get_by_role("link", name=PREFIX).wait_for()
    # The browser itself reports an answer with status 404.
    visited.problems[:] = [each for each in visited.problems if "404" not in each]


def test_a_model_whose_settings_broke_is_shown_again_by_itself(served, visit, models):
    visited = visit(f"{served.url}/#/model?prefix={PREFIX}")
    page = visited.page
    page.get_by_role("button", name="Evaluate").wait_for()
    run_env = served.folder / "run.env"
    right = run_env.read_text()

    run_env.write_text(f"{right}DR_EVAL_NUMBER_OF_TRIALS=many\n")

    page.get_by_text("DR_EVAL_NUMBER_OF_TRIALS").first.wait_for()
    run_env.write_text(right)
    page.get_by_text("DR_EVAL_NUMBER_OF_TRIALS").first.wait_for(state="detached")
    page.get_by_text("reinvent_base, time trial.").wait_for()
    # The browser itself reports what was asked for meanwhile.
    visited.problems[:] = [each for each in visited.problems if "422" not in each]


def test_an_action_that_is_refused_says_why(served, visit, models):
    visited = visit(f"{served.url}/#/model?prefix={PREFIX}")
    page = visited.page
    page.get_by_role("button", name="Download").click()
    page.get_by_label("What", exact=True).select_option("logs")
    page.get_by_role("dialog").get_by_role("button", name="Download").click()

    page.get_by_text("has no logs").wait_for()


def test_the_order_and_the_search_stay_in_the_address_and_two_models_are_compared(
    served, visit, models
):
    models.model("another")
    page = visit(f"{served.url}/#/models").page
    page.get_by_role("link", name="another").wait_for()
    page.get_by_role("button", name="Model", exact=True).click()
    page.get_by_label("Search").fill("o")
    page.reload()
    page.get_by_role("link", name="another").wait_for()

    assert page.get_by_label("Search").input_value() == "o"
    assert page.get_by_role("columnheader", name="Model").get_attribute("aria-sort") == "ascending"
    assert page.get_by_role("columnheader", name="Last checkpoint").is_visible()
    names = page.get_by_role("rowheader").get_by_role("link")
    assert names.all_inner_texts() == ["another", PREFIX]
    page.get_by_label("Compare another").check()
    page.get_by_label(f"Compare {PREFIX}").check()
    page.get_by_role("link", name=f"Compare another and {PREFIX}").click()
    page.get_by_role("heading", name="Differences from another").wait_for()
    curves = page.get_by_role("img", name="Mean reward")
    curves.wait_for()
    assert "another" in curves.get_attribute("aria-label")


def test_a_checkpoint_is_cloned_and_what_its_model_brings_is_shown(served, visit, models):
    own = served.folder / "custom_files"
    own.mkdir(exist_ok=True)
    (own / "reward_function.py").write_text("def reward_function(params):\n    return 2.0\n")
    page = visit(f"{served.url}/#/model?prefix={PREFIX}&tab=checkpoints").page
    page.get_by_role("row", name="0 best").get_by_role("button", name="Clone").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_text("reward_function.py of the model differs").click()

    assert dialog.get_by_label("Checkpoint").input_value() == "0"
    assert "+    return 1.0" in dialog.inner_text()
    assert dialog.get_by_label("Take its reward function").is_checked()


def test_the_ends_of_episodes_are_shown_for_all_iterations_or_some(served, visit, models):
    page = visit(f"{served.url}/#/models").page
    page.evaluate(
        """async () => {
            const { html, render } = await import("/ui.js");
            const { Ends } = await import("/model_overview.js");
            const ends = Array.from({ length: 40 }, (_, k) => [k >> 1, 1 + k / 40, 2]);
            const place = document.body.appendChild(document.createElement("section"));
            render(html`<${Ends} ends=${ends} world="reinvent_base" />`, place);
        }"""
    )
    page.get_by_text("40 episodes of iterations 0 to 19 ended").wait_for()
    page.get_by_label("All iterations").uncheck()
    page.get_by_text("4 episodes of iterations 18 to 19 ended").wait_for()
    page.get_by_label("Newest iteration that is shown").fill("1")

    page.get_by_text("4 episodes of iterations 0 to 1 ended").wait_for()
    assert "0 to 1" in page.get_by_role("img", name="Map of the ends").get_attribute("aria-label")


def test_what_a_dialog_asks_for_is_marked_where_it_is_refused_and_kept_until_it_is_taken(
    served, visit, models
):
    visited = visit(f"{served.url}/#/model?prefix={PREFIX}")
    page = visited.page
    dialog, name = page.get_by_role("dialog"), page.get_by_label("Name of the new model")
    page.get_by_role("button", name="Clone").click()
    page.get_by_label("What is it for?").fill("faster in the hairpin")
    name.fill("../up")
    dialog.get_by_role("button", name="Clone").click()

    dialog.get_by_text("“../up” is not the name of a model. Use letters").wait_for()
    assert name.get_attribute("aria-invalid") == "true"
    page.evaluate("location.hash = '#/models'")
    dialog.wait_for(state="detached")
    page.go_back()
    page.get_by_role("button", name="Clone").click()
    dialog.get_by_text("not saved is shown again").wait_for()
    assert page.get_by_label("What is it for?").input_value() == "faster in the hairpin"
    dialog.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Clone").click()
    assert page.get_by_label("What is it for?").input_value() == ""
    # The browser itself reports what was refused.
    visited.problems[:] = [each for each in visited.problems if "400" not in each]
