"""The page as a whole: what is in it, that nothing from files can run, and its size."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from drcli.analysis.analysis import analyse
from drcli.analysis.findings.advice_item import Advice
from drcli.analysis.report.graphs import Picture
from drcli.analysis.report.html_report import report_page, write_html
from drcli.tracks.limit_store import StoredLimit

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=\"alert(2)\">' onload='alert(3)"


class Page(HTMLParser):
    """Elements of a page, with the text of scripts and styles, and identities."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.inline: dict[str, list[str]] = {"script": [], "style": []}
        self.text = ""
        self._open = ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self._open = tag

    def handle_endtag(self, tag):
        self._open = ""

    def handle_data(self, data):
        if self._open in self.inline:
            self.inline[self._open].append(data)
        else:
            self.text += data

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def html(analysis) -> str:
    return report_page(analysis)


@pytest.fixture(scope="module")
def page(html) -> Page:
    return Page(html)


def data_of(page: Page) -> dict:
    scripts = zip(page.all("script"), page.inline["script"], strict=True)
    [data] = [text for attributes, text in scripts if attributes.get("type")]
    return json.loads(data)


def test_the_page_has_its_sections_in_order_and_a_sentence_in_each(page):
    keys = [attributes["id"] for attributes in page.all("section")]

    order = [
        "verdict",
        "reward",
        "laps",
        "track",
        "ends",
        "actions",
        "steering",
        "reward-rate",
        "horizon",
        "settings",
    ]
    assert [key for key in keys if key in order] == order
    assert set(keys) - set(order) <= {"learner"}
    looks = [a for a in page.all("p") if a.get("class") == "look"]
    assert len(looks) == len(keys)
    links = [a["href"] for a in page.all("a")]
    assert links == [f"#{key}" for key in keys]


def test_nothing_is_loaded_from_anywhere(page, html):
    for _, attributes in page.elements:
        for name in ("src", "href", "action", "poster", "srcset"):
            assert (attributes.get(name) or "#").startswith(("data:", "#"))
        assert not any(name.startswith("on") or name == "style" for name in attributes)
    assert "@import" not in html
    assert "url(" not in "".join(page.inline["style"])


def test_only_our_own_scripts_and_styles_may_run(page):
    [policy] = [
        a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy"
    ]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))

    assert rules["default-src"] == "'none'"
    for kind in ("script", "style"):
        texts = [text for text in page.inline[kind] if not text.startswith("{")]  # data
        digests = [hashlib.sha256(text.encode()).digest() for text in texts]
        hashes = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
        assert rules[f"{kind}-src"].split() == hashes
    assert [a["type"] for a in page.all("script") if a] == ["application/json"]


def test_names_and_prints_from_files_stay_text(analysis):
    run = replace(
        analysis.run,
        name=HOSTILE,
        origin=HOSTILE,
        world=HOSTILE,
        parent=HOSTILE,
        problems=(HOSTILE,),
        hyperparameters={HOSTILE: HOSTILE, "list": [HOSTILE]},
        files={"reward_function.py": HOSTILE, HOSTILE: f"{HOSTILE}=1", "settings": HOSTILE},
        parent_files={"reward_function.py": f"x\n{HOSTILE}", "settings": f"A={HOSTILE}"},
        episodes=analysis.run.episodes.assign(status=HOSTILE),
        learner=analysis.run.learner.assign(**{HOSTILE: 1.0}),
    )
    advice = Advice(HOSTILE, HOSTILE, HOSTILE, {HOSTILE: 1.0}, HOSTILE, HOSTILE)
    harmless = Page(report_page(analysis))

    page = Page(report_page(replace(analysis, run=run, advice=(advice,)), [Picture(b"x", HOSTILE)]))

    assert len(page.all("script")) == len(harmless.all("script")) == 4
    assert not page.all("img")
    assert not any("onerror" in attributes for _, attributes in page.elements)
    assert HOSTILE in page.text
    assert data_of(page)["map"]["statuses"]


def test_graphs_in_the_page_have_their_numbers(page, run):
    data = data_of(page)

    places = {a["data-graph"] for a in page.all("div") if "data-graph" in a}
    assert places == set(data["graphs"])
    [mean] = [s for s in data["graphs"]["reward"]["series"] if s["name"] == "mean reward"]
    np.testing.assert_allclose(mean["y"], run.iterations["mean_reward"], rtol=1e-5)
    assert data["graphs"]["reward"]["marks"][0]["label"].startswith("best: ")


def test_the_map_has_all_laps_of_a_short_training(page, run):
    drawn = data_of(page)["map"]

    firsts = drawn["laps"]["first"]
    steps = len(base64.b64decode(drawn["steps"]["yaw_rad"]["i8"]))
    assert len(firsts) == len(run.episodes) + 1
    assert firsts[-1] == steps == len(run.steps)
    assert len(drawn["track"]["center"]) == len(run.track.center)
    assert len(drawn["cells"]["periods"]) == 6


def test_a_run_without_a_track_positions_or_laps_still_has_a_page(analysis):
    lost = analysis.run.steps.assign(x=np.nan)
    run = replace(
        analysis.run, track=None, world=None, steps=lost, hyperparameters={}, actions=None
    )

    page = Page(report_page(analyse(run)))

    keys = [attributes["id"] for attributes in page.all("section")]
    assert "track" not in keys
    assert "reward" in keys
    assert "track not known" in page.text


def test_a_run_without_any_step_still_has_a_page(analysis):
    empty = {
        name: getattr(analysis.run, name).iloc[:0] for name in ("steps", "episodes", "iterations")
    }

    page = Page(report_page(analyse(replace(analysis.run, **empty))))

    assert page.all("section")[0]["id"] == "verdict"


def test_pictures_are_in_the_page_with_captions_and_numbers(analysis):
    picture = Picture(b"\x89PNG\r\n\x1a\nrest", "Frame 3", {"left": 0.25})

    page = Page(report_page(analysis, [picture]))

    [image] = page.all("img")
    assert image["src"] == "data:image/png;base64," + base64.b64encode(picture.png).decode()
    assert image["alt"] == "Frame 3"
    assert "0.25" in page.text


def test_differences_from_the_parent_are_shown(analysis):
    run = replace(
        analysis.run,
        parent="rl-before",
        files={"hyperparameters.json": '{"lr": 0.001}', "reward_function.py": "a\nnew\n"},
        parent_files={"hyperparameters.json": '{"lr": 0.0003}', "reward_function.py": "a\nold\n"},
    )

    text = Page(report_page(replace(analysis, run=run))).text

    assert re.search(r"lr\s*0.0003\s*0.001", text)
    assert "-old" in text
    assert "+new" in text


def test_the_size_of_a_report_is_told(analysis, tmp_path):
    report = tmp_path / "report.html"

    assert write_html(analysis, report) == report.stat().st_size


def test_the_report_of_a_recorded_training_is_small(reference_run, tmp_path):
    size = write_html(analyse(reference_run("drfc-time-trial")), tmp_path / "report.html")

    assert 200_000 < size < 3_000_000


def test_the_fastest_lap_is_compared_with_the_fastest_line(analysis):
    run = analysis.run
    if run.track is None or not run.episodes["complete"].any():
        pytest.skip("The training has no lap on a known track.")
    lap_s = float(run.episodes.loc[run.episodes["complete"].astype(bool), "time"].min())
    stations = 60
    line = StoredLimit(
        route="",
        reverse=False,
        car="release-6",
        world="",
        computed_s=lap_s / 2,
        driven_s=lap_s / 2,
        standing_s=None,
        seed=1,
        version=1,
        length_m=run.track.length_m,
        offset_mm=(0,) * stations,
        speed_mmps=(3000,) * stations,
        clock_ms=tuple((500 * lap_s / stations * np.arange(stations)).astype(int).tolist()),
    )

    page = Page(report_page(analyse(replace(run, limit=line))))

    assert "100 % above the limit of this car on this track" in page.text
    assert "Most time is lost at:" in page.text
    assert len(re.findall(r"waypoints \d+ to \d+: \d", page.text)) == 3
    assert any("fastest line" in (image["alt"] or "") for image in page.all("img"))
