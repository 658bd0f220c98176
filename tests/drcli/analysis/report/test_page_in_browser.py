"""The page in a real browser: it runs under its own rules, and keys and controls work."""

from dataclasses import replace
from functools import partial

import pytest

from browser import headless_browser
from drcli.analysis.compare_runs import compare_runs
from drcli.analysis.report import html_report
from drcli.analysis.report.compare_report import write_comparison
from drcli.analysis.report.html_report import write_html
from drcli.analysis.report.lap_choice import choose_laps

HOSTILE = "</script><script>document.title = 'taken'</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def browser():
    with headless_browser() as found:
        yield found


@pytest.fixture(scope="module")
def report(analysis, tmp_path_factory):
    """A report with a name that tries to run a script."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_html(replace(analysis, run=replace(analysis.run, name=HOSTILE)), path)
    return path


@pytest.fixture
def page(browser, report):
    """The page on a phone; the test fails if it loads something or reports an error."""
    context = browser.new_context(viewport={"width": 360, "height": 760}, color_scheme="dark")
    page = context.new_page()
    wrong = []
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("dialog", lambda dialog: wrong.append(dialog.message))
    page.on("request", lambda request: wrong.append(request.url) if ":/" in request.url else None)
    page.goto(report.as_uri())
    wrong.remove(report.as_uri())
    yield page
    context.close()
    assert wrong == []


def colors_of(page) -> int:
    """How many colours the map shows."""
    return page.evaluate(
        """() => {
          const canvas = document.querySelector("#map canvas");
          const seen = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
          return new Set(new Uint32Array(seen.data.buffer)).size;
        }"""
    )


def test_it_fits_a_phone_draws_all_graphs_and_runs_no_foreign_script(page):
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    assert page.title().startswith(HOSTILE[:20])
    assert page.locator("html").get_attribute("data-theme") == "dark"
    graphs = page.locator("[data-graph]")
    for number in range(graphs.count()):
        graphs.nth(number).locator(".uplot canvas").wait_for()
    assert graphs.count() >= 3
    assert colors_of(page) > 20


def test_a_switch_hides_a_series_and_keys_read_the_values(page):
    graph = page.locator("[data-graph=reward]")
    graph.get_by_role("button", name="Reward of an episode").click()
    graph.locator(".plot").focus()

    page.keyboard.press("ArrowRight")

    graph.get_by_text("Iteration 0: mean reward").wait_for()
    assert "reward of an episode" not in graph.locator(".readout").inner_text()
    assert "Iteration 0" in graph.get_by_role("img").get_attribute("aria-label")


def test_laps_can_be_played_and_stepped_by_keys(page):
    page.get_by_role("combobox", name="Show", exact=True).select_option("fastest")
    played = page.locator(".played")
    played.focus()
    readout = page.locator(".position")
    end = readout.inner_text()

    page.keyboard.press("Home")
    page.get_by_text(
        " at 0.1 s: "
    ).wait_for()  # the first row is at the end of the step of the reset
    start = readout.inner_text()
    page.get_by_role("button", name="Play").click()
    expect = pytest.importorskip("playwright.sync_api").expect
    expect(readout).not_to_have_text(start)
    page.get_by_role("button", name="Pause").click()
    played.focus()
    page.keyboard.press("End")

    expect(readout).to_have_text(end)


def test_any_iteration_can_be_shown(page):
    page.locator(".played").focus()
    page.keyboard.press("PageUp")  # shows the newest
    page.get_by_text("Iteration 5", exact=True).wait_for()
    rows = page.get_by_role("region", name="Laps on the map").locator("tbody tr")
    assert rows.count() == 10

    page.keyboard.press("PageDown")

    page.get_by_text("Iteration 4", exact=True).wait_for()
    assert rows.first.inner_text().split()[1] == "4"


def test_a_click_on_the_map_goes_to_a_step_of_a_lap_and_areas_are_read(page):
    page.get_by_role("combobox", name="Show", exact=True).select_option("fastest")
    canvas = page.locator("#map canvas")
    canvas.scroll_into_view_if_needed()
    end = page.locator(".position").inner_text()
    box = canvas.bounding_box()

    for across in range(5, 100, 5):
        canvas.click(position={"x": box["width"] * across / 100, "y": box["height"] / 2})
        if page.locator(".position").inner_text() != end:
            break
    else:
        pytest.fail("no place of a lap was found")

    page.get_by_role("combobox", name="Show", exact=True).select_option("steps-0")
    for across in range(5, 100, 5):
        canvas.hover(position={"x": box["width"] * across / 100, "y": box["height"] / 2})
        if page.get_by_text("Here, mean of").count():
            break
    else:
        pytest.fail("no place that was driven was found")


def test_laps_can_be_hidden_and_ends_shown(page):
    page.get_by_role("combobox", name="Show", exact=True).select_option("worst")
    page.get_by_label("where episodes ended").check()
    page.locator(".keys .key").first.wait_for()
    canvas = page.locator("#map canvas")
    before = canvas.evaluate("canvas => canvas.toDataURL()")

    for tick in page.locator(".laps").get_by_role("checkbox").all():
        tick.uncheck()

    page.locator(".keys .key").first.wait_for(state="detached")
    assert canvas.evaluate("canvas => canvas.toDataURL()") != before


def test_colours_follow_the_reader(page):
    page.locator("#theme").click()

    assert page.locator("html").get_attribute("data-theme") == "light"
    paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert paper == "rgb(255, 255, 255)"
    page.get_by_role("combobox", name="Show", exact=True).select_option("steps-5")
    page.get_by_role("combobox", name="Colours", exact=True).select_option("driven")
    page.get_by_text("driven speed: ").wait_for()
    assert colors_of(page) > 20


OLD_BROWSER = """
HTMLCanvasElement.prototype.getContext = () => null;
Object.defineProperty(window, "uPlot", { get() { throw new Error("no Path2D"); }, set() {} });
"""


def test_graphs_and_a_map_that_fail_say_so_and_the_rest_works(browser, report):
    context = browser.new_context()
    page = context.new_page()
    page.set_default_timeout(5000)
    page.add_init_script(OLD_BROWSER)
    page.goto(report.as_uri())

    for place in ("[data-graph=reward]", "#map"):
        page.locator(place).scroll_into_view_if_needed()
        page.locator(place).get_by_text("This browser cannot show it").wait_for()
    page.locator("#theme").click()

    assert page.locator("html").get_attribute("data-theme") == "dark"
    context.close()


def test_the_page_of_a_comparison_fits_a_phone_and_draws_its_lines(browser, run, tmp_path):
    path = tmp_path / "compare.html"
    write_comparison(compare_runs([run, replace(run, name="other")]), path)
    context = browser.new_context(viewport={"width": 360, "height": 760})
    page = context.new_page()
    page.set_default_timeout(5000)
    wrong = []
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(path.as_uri())

    graph = page.locator("[data-graph=progress-steps]")
    graph.locator(".uplot canvas").wait_for()
    graph.locator(".plot").focus()
    page.keyboard.press("ArrowRight")

    readout = graph.locator(".readout").inner_text()
    assert readout.startswith("steps ")
    assert "other" in readout
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    assert wrong == []
    context.close()


def test_an_arrow_key_moves_to_the_next_step_that_the_page_has(
    browser, analysis, tmp_path, monkeypatch
):
    few = partial(choose_laps, most_steps=len(analysis.run.steps) // 8)
    monkeypatch.setattr(html_report, "choose_laps", few)
    path = tmp_path / "report.html"
    write_html(analysis, path)
    context = browser.new_context()
    page = context.new_page()
    page.set_default_timeout(5000)
    page.goto(path.as_uri())
    page.get_by_text("with every second step").or_(
        page.get_by_text("with every 4th step")
    ).wait_for()
    page.get_by_role("combobox", name="Show", exact=True).select_option("fastest")
    page.locator(".played").focus()
    readout = page.locator(".position")

    page.keyboard.press("Home")
    texts = [readout.inner_text()]
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "ArrowLeft"):
        page.keyboard.press(key)
        texts.append(readout.inner_text())

    assert len(set(texts)) == 3
    assert texts == texts[::-1]
    context.close()
