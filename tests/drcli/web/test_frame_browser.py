"""The frame of the page in a browser: it says what is wrong, recovers, and stays small."""

import pytest

from axe import serious_findings
from drcli.web import console_app, run_topics
from drcli.web.hub import Stored
from drcli.web.topics import Rows, Snapshot
from served_console import served_console


@pytest.fixture
def reports(monkeypatch, make_report):
    """What is found of the run; looked up ten times a second."""
    found = {"report": make_report(iterations=3)}
    monkeypatch.setattr(run_topics, "inspect", lambda config, reader: found["report"])
    monkeypatch.setattr(run_topics, "RUN_S", 0.1)
    monkeypatch.setattr(run_topics, "NEW_S", 0.05)
    return found


def connection(page):
    return page.locator("#connection")


def test_the_page_follows_a_training_to_its_end_and_the_next_one(
    served, visit, reports, make_report
):
    page = visit(served.url).page
    main = page.locator("main")
    main.get_by_text("runs", exact=False).first.wait_for()
    connection(page).get_by_text("Connected").wait_for()
    reports["report"] = make_report("finished", iterations=4)
    main.get_by_text("has finished").wait_for()
    reports["report"] = make_report("none")
    main.get_by_text("There is no training yet").wait_for()
    reports["report"] = make_report(iterations=1)
    main.get_by_text("runs", exact=False).first.wait_for()


def test_the_page_shows_broken_settings_until_they_are_repaired(served, visit, reports):
    run_env = served.folder / "run.env"
    right = run_env.read_text()
    page = visit(served.url).page
    page.locator("main").get_by_text("runs", exact=False).first.wait_for()
    run_env.write_text(right + "DR_WORKERS=several\n")
    problem = page.locator("main").get_by_text("DR_WORKERS")
    problem.first.wait_for()
    run_env.write_text(right)
    problem.first.wait_for(state="detached")


def test_a_page_opened_with_broken_settings_offers_to_resume_after_the_repair(
    served, visit, reports, make_report
):
    run_env = served.folder / "run.env"
    right = run_env.read_text()
    run_env.write_text(right + "DR_WORKERS=several\n")
    reports["report"] = make_report("finished", iterations=1)
    visited = visit(served.url)
    page = visited.page
    page.locator("main").get_by_text("DR_WORKERS").first.wait_for()
    run_env.write_text(right)
    page.get_by_role("button", name="Resume the training").wait_for()
    visited.problems.clear()  # the browser reports the refused request for the folder


def test_the_page_says_that_the_console_is_away_and_finds_it_again(working_folder, visit, reports):
    with served_console(working_folder) as first:
        page = visit(first.url).page
        connection(page).get_by_text("Connected").wait_for()
        port = first.port
    connection(page).get_by_text("No connection").wait_for()
    assert "dr console start" in connection(page).inner_text()
    assert "`" not in connection(page).inner_text()
    with served_console(working_folder, port=port):
        connection(page).get_by_text("Connected").wait_for()
        page.locator("main").get_by_text("runs", exact=False).first.wait_for()
        page.context.close()


def test_a_page_whose_token_is_no_longer_right_asks_for_the_new_one(
    working_folder, browser, reports
):
    page = browser.new_context().new_page()
    with served_console(working_folder, token="the-first-token") as first:
        page.goto(f"{first.url}/enter?token=the-first-token")
        connection(page).get_by_text("Connected").wait_for()
        port = first.port
    with served_console(working_folder, token="the-second-token", port=port):
        connection(page).get_by_role("link", name="Enter the token").click()
        page.get_by_label("Token").fill("the-second-token")
        page.get_by_role("button", name="Open").click()
        connection(page).get_by_text("Connected").wait_for()
        page.context.close()


@pytest.mark.parametrize("width", [360, 1280])
def test_a_bookmark_is_asked_for_the_token_once_and_then_kept_also_by_a_console_started_again(
    working_folder, browser, reports, width
):
    page = browser.new_context(viewport={"width": width, "height": 700}).new_page()
    with served_console(working_folder, token="the-token") as first:
        bookmark, port = f"{first.url}/", first.port
        page.goto(bookmark)
        assert page.get_by_role("alert").inner_text() == "This console needs its token."
        page.get_by_text("dr console", exact=True).wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert serious_findings(page) == []
        page.get_by_label("Token").fill("not-the-token")
        page.get_by_role("button", name="Open").click()
        page.get_by_text("This is not the token of this console.").wait_for()
        page.goto(f"{bookmark}enter?token=the-token#/models")
        page.get_by_role("heading", name="Models").wait_for()
        assert page.url == f"{bookmark}#/models"
    with served_console(working_folder, token="the-token", port=port):
        connection(page).get_by_text("Connected").wait_for()
        page.goto("about:blank")
        page.goto(bookmark)
        connection(page).get_by_text("Connected").wait_for()
        page.context.close()


def test_a_link_in_a_file_opens_the_page_though_its_cookie_is_for_its_own_site_only(
    working_folder, browser, reports, tmp_path
):
    page = browser.new_context().new_page()
    link = tmp_path / "open.html"
    with served_console(working_folder, token="the-token") as served:
        url = f"{served.url}/enter?token=the-token"
        link.write_text(f'<meta http-equiv="refresh" content="0; url={url}">')
        page.goto(link.as_uri())
        connection(page).get_by_text("Connected").wait_for()
        assert page.url == f"{served.url}/"
        page.context.close()


@pytest.mark.parametrize(("theme", "width"), [("dark", 360), ("light", 800), ("dark", 1920)])
def test_the_page_fits_and_is_named_and_reachable_by_keyboard(served, visit, reports, theme, width):
    page = visit(served.url, theme=theme, width=width).page
    page.locator("main").get_by_text("runs", exact=False).first.wait_for()

    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("document.documentElement.dataset.theme") == theme
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    names = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        names.add(
            page.evaluate(
                "document.activeElement.getAttribute('aria-label')"
                " ?? document.activeElement.innerText"
            )
        )
    assert {"DeepRacer console", "Live", "Dark or light"} <= names
    assert page.evaluate("document.title") == "Live – DeepRacer console"
    assert serious_findings(page) == []


def test_the_theme_is_kept(served, visit, reports):
    page = visit(served.url, theme="light").page
    page.get_by_role("button", name="Dark or light").click()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.reload()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"


def test_pictures_have_the_colours_that_the_system_changes_to(served, visit, reports):
    page = visit(served.url, theme="light").page
    page.get_by_role("button", name="Dark or light").get_by_text("Dark").wait_for()
    page.emulate_media(color_scheme="dark")
    page.get_by_role("button", name="Dark or light").get_by_text("Light").wait_for()
    page.get_by_role("button", name="Dark or light").click()
    page.emulate_media(color_scheme="light")
    page.emulate_media(color_scheme="dark")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"


@pytest.mark.parametrize(
    "place", ["/nothing", "/../x", "/%E0%A4%A", "/<img src=x onerror=alert(1)>"]
)
def test_a_place_that_does_not_exist_leads_back(served, visit, reports, place):
    page = visit(f"{served.url}/#{place}").page
    page.get_by_role("heading", name="There is no such page").wait_for()
    page.get_by_role("link", name="Open the live page").click()
    page.get_by_role("heading", name="Live").wait_for()


def test_the_skip_link_leads_to_the_content_of_the_same_page(served, visit, reports):
    page = visit(f"{served.url}/#/models").page
    page.get_by_role("heading", name="Models").wait_for()

    page.get_by_role("link", name="Skip to the content").press("Enter")

    assert page.evaluate("document.activeElement.id") == "main"
    assert page.url == f"{served.url}/#/models"


def test_a_notice_stays_until_it_is_closed_or_the_page_is_left(served, visit, reports):
    page = visit(served.url).page
    page.locator("main").get_by_text("runs", exact=False).first.wait_for()
    notices = page.get_by_role("alert").locator(".notice")
    tell = """async (given) => {
        const { notify } = await import("/notices.js");
        notify(...given);
    }"""

    page.evaluate(tell, ["DR_X is wrong.", "bad", "Use `dr-validate`."])
    page.evaluate(tell, ["DR_X is wrong.", "bad", "Use `dr-validate`."])
    page.evaluate(tell, ["The disk is nearly full.", "warn"])

    assert notices.count() == 2
    assert notices.first.locator("code").inner_text() == "dr-validate"
    assert [each.get_attribute("class") for each in notices.all()] == ["notice bad", "notice warn"]
    page.keyboard.press("Escape")
    assert notices.count() == 1
    page.get_by_role("link", name="Models").click()
    page.get_by_role("heading", name="Models").wait_for()
    assert notices.count() == 0


def test_a_page_whose_module_could_not_be_fetched_comes_when_the_console_is_back(
    working_folder, visit, reports
):
    with served_console(working_folder) as first:
        page = visit(first.url).page
        connection(page).get_by_text("Connected").wait_for()
        port = first.port
    connection(page).get_by_text("No connection").wait_for()
    page.get_by_role("link", name="Races").click()
    page.get_by_text("This page cannot be shown").wait_for()
    with served_console(working_folder, port=port):
        page.get_by_role("heading", name="Races").wait_for()
        page.context.close()


@pytest.fixture
def busy(working_folder, monkeypatch, reports):
    """A console whose run changes as often as somebody says."""
    folders = []
    parts = (*console_app.PARTS, lambda folder: folders.append(folder) or [])
    monkeypatch.setattr(console_app, "PARTS", parts)
    with served_console(working_folder) as console:
        hub = folders[0].hub
        state = run_topics.shown_run(reports["report"], [], 0)
        hub.add_kind(
            "run", lambda topic, publish: Stored(publish, lambda: Snapshot.of(topic, state))
        )
        rows = Rows("iterations:0")
        rows.update(reports["report"].history)
        hub.add_kind("iterations", lambda _, publish: Stored(publish, lambda: rows))
        yield console, hub, rows


def test_a_page_that_is_left_open_does_not_grow(busy, visit, reports, make_record):
    console, hub, rows = busy
    page = visit(console.url).page
    page.locator("main").get_by_text("runs", exact=False).first.wait_for()
    session = page.context.new_cdp_session(page)
    history = [make_record(n) for n in range(100)]

    def memory(rounds):
        """Bytes of the page's heap, and its elements, after so many changes."""
        for number in range(rounds):
            history[-1] = make_record(99, mean_reward=float(number))
            rows.update(history)
            hub.publish("iterations:0", rows)
            state = {**run_topics.shown_run(reports["report"], [], 0), "limit": str(number)}
            hub.publish("run:0", Snapshot.of("run:0", state))
            if number % 20 == 0:
                page.evaluate("new Promise(requestAnimationFrame)")
        session.send("HeapProfiler.collectGarbage")
        session.send("HeapProfiler.collectGarbage")
        counted = session.send("Memory.getDOMCounters")
        return (
            session.send("Runtime.getHeapUsage")["usedSize"],
            counted["nodes"],
            counted["jsEventListeners"],
        )

    before = memory(300)
    after = memory(1500)

    assert after[0] < before[0] + 2_000_000
    assert after[1] < before[1] + 500
    assert after[2] < before[2] + 50
