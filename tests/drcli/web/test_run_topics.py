"""Topics of a run: what they show, also when settings or the bucket are broken, and their cost."""

from dataclasses import replace

import pytest

from drcli.base.errors import StorageError
from drcli.run.heartbeat_monitor import WorkerHealth
from drcli.run.status import WorkerReport
from drcli.web import run_topics
from drcli.web.run_topics import RunReader


@pytest.fixture
def reports(monkeypatch, make_report):
    """What `inspect` finds from now on; each look is noted."""
    found = {"report": make_report(iterations=3), "looks": []}

    def inspect(config, reader):
        found["looks"].append(config.run_id)
        if isinstance(found["report"], Exception):
            raise found["report"]
        return found["report"]

    monkeypatch.setattr(run_topics, "inspect", inspect)
    monkeypatch.setattr(run_topics, "RUN_S", 0.02)
    monkeypatch.setattr(run_topics, "NEW_S", 0.01)
    return found


def test_the_state_is_sent_without_the_iterations_and_these_one_by_one(
    served, reports, make_report
):
    with served.watching("run", "iterations") as page:
        run = page.next("run")
        assert run["state"] == "running"
        assert "history" not in run
        first = page.next("iterations")
        assert (first["start"], len(first["rows"])) == (0, 3)
        reports["report"] = make_report(iterations=5)
        # The last row of before has got its evaluation meanwhile.
        later = page.next("iterations")
        assert (later["start"], len(later["rows"])) == (2, 3)
        reports["report"] = make_report("finished", iterations=5)
        assert page.next("run", lambda run: run["state"] == "finished")["message"]


def test_five_looks_within_a_second_cost_one_reading(served, reports, monkeypatch):
    monkeypatch.setattr(run_topics, "NEW_S", 60.0)
    reader = RunReader(_Folder(served), None)
    for _ in range(5):
        reader.report()
    assert len(reports["looks"]) == 1


class _Folder:
    def __init__(self, served):
        from drcli.config.loading import load_settings

        self.settings = lambda: load_settings(served.folder)


def test_the_page_hears_of_broken_settings_and_of_their_repair(served, reports):
    run_env = served.folder / "run.env"
    right = run_env.read_text()
    with served.watching("run") as page:
        page.next("run", lambda run: "error" not in run)
        run_env.write_text(right + "DR_WORKERS=several\n")
        error = page.next("run", lambda run: "error" in run)["error"]
        assert "DR_WORKERS" in error["message"]
        assert error["code"] == 3
        run_env.write_text(right)
        assert page.next("run", lambda run: "error" not in run)["state"] == "running"


def test_the_page_hears_of_a_bucket_that_is_away_and_comes_back(served, reports, make_report):
    with served.watching("run", "machine") as page:
        page.next("run", lambda run: "error" not in run)
        reports["report"] = StorageError("The bucket does not answer.", remedy="Wait.")
        error = page.next("run", lambda run: "error" in run)["error"]
        assert (error["message"], error["remedy"]) == ("The bucket does not answer.", "Wait.")
        assert page.next("machine")["cores"] >= 1
        reports["report"] = make_report("interrupted", iterations=3)
        assert page.next("run", lambda run: "error" not in run)["state"] == "interrupted"


def test_curves_stay_while_the_bucket_does_not_answer(served, reports, make_report):
    with served.watching("run", "iterations") as page:
        assert len(page.next("iterations")["rows"]) == 3
        away = "The bucket does not answer."
        reports["report"] = make_report(iterations=0, unreachable=away)
        assert page.next("run", lambda run: run["unreachable"])["unreachable"] == away
        reports["report"] = make_report(iterations=4)
        assert page.next("iterations")["start"] == 2


def test_the_run_of_another_number_is_its_own_topic(served, reports, make_report):
    with served.watching("run:7") as page:
        page.next("run:7")

    assert set(reports["looks"]) == {7}


def test_without_a_page_nothing_is_read(served, reports):
    with served.watching("run") as page:
        page.next("run")
        page.watch("tasks")
        page.next("tasks")
        read = len(reports["looks"])
        page.watch("tasks", "machine")
        page.next("machine")

    assert len(reports["looks"]) <= read + 1  # one may have been under way


def test_a_folder_says_what_it_trains(client):
    about = client.get("/api/folder").json()

    assert (about["model"], about["world"], about["run_exists"]) == (
        "model",
        "reinvent_base",
        False,
    )


def test_a_report_of_nothing_has_an_answer(client, make_report):
    report = replace(make_report(), workers=[], history=[])

    assert run_topics.shown_run(report, [], 0)["cards"] == ()


def test_what_changes_unseen_is_not_sent_again(make_report):
    def after(age_s):
        health = WorkerHealth(1, age_s, age_s, 801.0 + age_s, 9)
        return make_report(workers=[WorkerReport("trainer", 1, True, 0, "learns", "", health)])

    earlier, later = (run_topics.shown_run(after(age_s), [], 0) for age_s in (0.5, 1.5))

    assert earlier == later
    assert earlier["words"]["others"] == "trainer learns (800 MB)."
